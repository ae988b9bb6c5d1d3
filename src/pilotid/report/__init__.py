"""The report of a study, from its store alone.

Imports `study` for the numbers and `show` for their form.  Start at `page`; an experiment is a
chapter in `chapters`.
"""
