"""Responses at the forcing lines, the pilot fitted to them, and regression on lagged signals.

Imports models, recordings, checks, estimates and `solve`.  Start at `coefficients`.
"""
