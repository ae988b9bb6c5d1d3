"""Recordings: the one data object, and the files it is read from and written to.

Imports `support` alone.  Start at `recording`, then `files`: `table` and `arrays` read formats into
a `Content`, `roles` makes a recording of it.
"""
