"""What an estimator can reach, from exact closed-loop spectra: bounds, bias, sandwich.

Imports pilots and `solve`; sees neither recordings nor the prediction engine.  Start at
`bounds`.
"""
