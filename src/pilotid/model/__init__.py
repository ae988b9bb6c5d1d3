"""The pilot and what it controls: models as products of factors, controlled elements, loops.

Imports `support` and `naming`.  Start at `model`: a channel is a signed product of `factors`,
a model is a sum of channels; `catalogue` has the models by name.
"""
