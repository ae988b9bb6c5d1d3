"""Recordings: the one data object, and the files it is read from and written to.

Imports `support` alone.  Start at `recording`, then `files`: each format's reader makes `arrays`,
of which every recording is assembled.
"""
