"""Forcing functions designed before an experiment; the conic program is in `optimum`."""
