"""Bounded least squares by Gram matrices, searches, intervals and covariances.

Works on any problem that gives Gram matrices of residual and Jacobian; knows nothing of
signals.  Start at `least_squares`.
"""
