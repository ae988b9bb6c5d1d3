"""Forcing lines, the pilot fitted to them, and regression on lagged signals.

Imports pilots, recordings, estimates, `solve` and `element`.  Start at `coefficients`.
"""
