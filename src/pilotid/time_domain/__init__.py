"""The prediction engine: recordings filtered and predicted, remnant and pilot estimated together.

Imports pilots, recordings, estimates, `solve` and `lines`.  Start at `prediction`; `output_error`
and `prediction_errors` are its two least-squares problems, `maximum_likelihood` solves the second.
"""
