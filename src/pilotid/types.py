"""Array types and the one error class that carries a sentence for the user."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]


class InputError(ValueError):
    """The user's input cannot be used; the message says what, where and what to do.

    The command line prints it as one sentence and leaves with exit status 2.
    """
