"""The prediction engine: recordings filtered and predicted, remnant and pilot estimated together.

Imports models, recordings, checks, estimates, `solve` and `spectral`.  Read it in
the order of docs/theory/pipeline.md: `prepare`, `prediction`, `band_likelihood`, `likelihood`,
`search`; then `posterior`, and `choice` of the model that a recording supports.
"""
