"""The posterior of pilot and remnant: priors, likelihood, sampling, and what follows from draws.

Imports `likelihood` and all beneath it.  Start at `likelihood`.
"""
