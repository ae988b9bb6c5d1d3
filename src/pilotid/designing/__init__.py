"""Experiments designed before they are recorded: forcing functions, time, subjects, runs.

Start at `design`; the conic program is in `optimum`.
"""
