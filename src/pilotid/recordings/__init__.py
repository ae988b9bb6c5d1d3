"""Recordings: the one data object, and the files it is read from and written to.

Imports `types` and `disk`; knows neither pilots nor estimates.  Start at `recording`, then
`files`: each format's reader makes `contents`, of which every recording is assembled.
"""
