"""The prediction engine: recordings filtered and predicted, remnant and pilot estimated together.

Imports models, recordings, estimates, `solve` and `spectral`.  Start at `prediction`;
`likelihood` is the least-squares problem, which `search` solves.
"""
