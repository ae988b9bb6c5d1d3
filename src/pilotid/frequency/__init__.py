"""Two-step methods: black-box regression, and the fit to responses that all of them end with.

Imports what `time_domain` may import, and `time_domain`; not `posterior`.  Start at
`second_step`, which every two-step method ends with.
"""
