"""Scenarios x methods x replications: fits, their store, their scores.

The only package in which truth meets estimate.  Imports methods and data sets.  Start at `study`;
what came out of one is a `Comparison` in `table`, whose columns `scores` makes.
"""
