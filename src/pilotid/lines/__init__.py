"""The forcing functions' lines: Fourier coefficients there, and pilots fitted to them alone.

Imports what `solve` may import, `recordings`, and `solve`.  Start at `fit`.
"""
