"""What is wrong with a recording, and what controls what in it.

Imports `recording` and `model`.  Start at `checks`, which runs them all; what a recorder does to
signals is found in `detectors`, which signal moves which in `plant`, the element in `element_fit`.
"""
