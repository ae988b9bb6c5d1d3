"""Responses at the forcing lines, the pilot fitted to them, and regression on lagged signals.

Imports models, recordings, checks, estimates, `solve` and `element_fit`.  Start at `coefficients`.
"""
