"""The command line.

Imports everything, heavy libraries where they are used.  Start at `main`: one function a
command; `arguments` says what options mean.
"""
