"""Two-step methods: Fourier coefficients or black-box regression, then a fit to responses.

Imports what `time_domain` may import, and `time_domain`; not `posterior`.  Start at
`second_step`, which every two-step method ends with.
"""
