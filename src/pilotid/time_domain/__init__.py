"""The prediction engine: recordings filtered and predicted, remnant and pilot estimated together.

Imports pilots, recordings, estimates, `solve` and `lines`.  Start at `prediction`; `likelihood`
is the least-squares problem, which `search` solves.
"""
