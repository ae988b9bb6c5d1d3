"""What a method is and what it returns.

Imports models and recordings; knows of no estimator.  Start at `method` (the protocol, and
`identify`), then `estimate`.
"""
