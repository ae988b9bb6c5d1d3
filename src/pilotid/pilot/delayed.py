"""Responses of delays at many frequencies; exponentials take longer than all else there."""

from __future__ import annotations

import math

import numpy as np

from pilotid.types import ComplexArray, FloatArray


class Delayed:
    """Responses e^{-i omega T} at fixed frequencies.

    The phase grows evenly from bin to bin of a transform, so that the exponentials are products
    of two short rows.

    Parameters
    ----------
    omega
        Frequencies [rad/s], shape (n,), from the lowest upwards.
    """

    def __init__(self, omega: FloatArray) -> None:
        self._omega = omega
        # Bins as a table of about as many rows as columns, if they lie evenly.
        even = omega.size > 1 and np.ptp(np.diff(omega)) <= 1e-9 * omega[-1]
        self._width = math.ceil(math.sqrt(omega.size)) if even else 0
        self._rows = 1j * omega[:: max(1, self._width)]
        self._columns = 1j * (omega[: self._width] - omega[:1])

    def __call__(self, seconds: FloatArray, gain: FloatArray | float = 1.0) -> ComplexArray:
        """A gain and a delay, shape (sets, n).

        Parameters
        ----------
        seconds, gain
            Shape (sets, 1).
        """
        if not self._width:
            angle = seconds * self._omega
            result = np.empty(angle.shape, dtype=complex)
            np.multiply(gain, np.cos(angle), out=result.real)
            np.multiply(-gain, np.sin(angle), out=result.imag)
            return result
        rows = gain * np.exp(-seconds * self._rows)
        columns = np.exp(-seconds * self._columns)
        table = rows[:, :, None] * columns[:, None, :]
        return np.asarray(table.reshape(len(table), -1)[:, : self._omega.size], dtype=complex)
