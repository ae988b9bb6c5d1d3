"""The remnant as a method saw it."""

from __future__ import annotations

from dataclasses import dataclass

from pilotid.types import FloatArray


@dataclass(frozen=True, eq=False)
class RemnantEstimate:
    """The remnant as a method saw it, inside its analysis band.

    Attributes
    ----------
    model
        Name of the noise model.
    parameters
        Its parameters by name (frequencies in rad/s).
    power_ratio
        var(n)/var(u).
    omega
        Frequencies [rad/s], shape (n,).
    density
        One-sided power spectral density [unit of u, squared, per rad/s], shape (n,).
    """

    model: str
    parameters: dict[str, float]
    power_ratio: float
    omega: FloatArray
    density: FloatArray
