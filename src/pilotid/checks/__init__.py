"""What is wrong with a recording, and what controls what in it.

Imports `recording` and `model`.  Start at `checks`: its table has every check with its code.
"""
