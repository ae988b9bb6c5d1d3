"""Experiments designed before they are recorded: forcing functions, time, subjects, runs.

Start at `design`; what is minimised is in `goals`, how in `solver`.
"""
