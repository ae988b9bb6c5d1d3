"""Recordings: the one data object, and the files it is read from and written to.

Imports `support` alone.  Start at `recording`, then `files`: `contents` reads formats into
named variables, `roles` makes a recording of them.
"""
