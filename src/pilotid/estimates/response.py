"""Frequency responses with their errors: the first step of a two-step method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pilotid.types import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Estimated responses of a pilot model's channels at some frequencies.

    Attributes
    ----------
    omega
        Frequencies [rad/s], ascending, shape (n,).
    value
        Response of every channel without its sign, so that u = visual e - vestibular x;
        complex, shape (channels, n).
    covariance
        Covariance of the real parts and then the imaginary parts of `value`, each channel
        by channel; shape (2 channels n, 2 channels n).
    systematic
        Size of errors that are not random, such as those of an interpolation; they are no
        part of the covariance.  Shape (channels, n).
    note
        What a reader should know of it, for messages and reports.
    """

    omega: FloatArray
    value: ComplexArray
    covariance: FloatArray
    systematic: FloatArray | None = None
    note: str = ""

    def __post_init__(self) -> None:
        size = 2 * self.value.size
        if self.value.ndim != 2 or self.value.shape[1] != self.omega.size:
            raise ValueError("the response must have the shape (channels, frequencies)")
        if self.covariance.shape != (size, size):
            raise ValueError(f"the covariance must have the shape ({size}, {size})")

    @property
    def std(self) -> FloatArray:
        """Root mean square of the random error, of value less true value, (channels, n)."""
        real, imaginary = np.diag(self.covariance).reshape(2, *self.value.shape)
        return np.asarray(np.sqrt(real + imaginary))

    def to_dict(self, names: Sequence[str]) -> dict[str, object]:
        """Plain objects, as JSON has them, with the channels by these names."""
        result: dict[str, object] = {"omega": self.omega.tolist()}
        if self.note:
            result["note"] = self.note
        for c, name in enumerate(names):
            entry = {
                "real": self.value[c].real.tolist(),
                "imag": self.value[c].imag.tolist(),
                "std": self.std[c].tolist(),
            }
            if self.systematic is not None:
                entry["systematic"] = self.systematic[c].tolist()
            result[name] = entry
        return result


def real_parts(value: ComplexArray) -> FloatArray:
    """Real and then imaginary parts of responses, in the order of the covariance.

    Parameters
    ----------
    value
        Responses, shape (..., channels, n).

    Returns
    -------
    Array of shape (..., 2 channels n).
    """
    parts = np.stack([value.real, value.imag], axis=-3)
    return parts.reshape(*value.shape[:-2], -1)


def circular(covariance: ComplexArray) -> FloatArray:
    """Covariance of real and imaginary parts of errors whose phase is random.

    Parameters
    ----------
    covariance
        E[z z^H] of the complex errors z, shape (m, m).

    Returns
    -------
    Array of shape (2 m, 2 m), real parts first.
    """
    real, imaginary = covariance.real, covariance.imag
    return 0.5 * np.block([[real, -imaginary], [imaginary, real]])
