"""The remnant: the part of the control that no linear model of the pilot explains."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from pilotid.support.types import ComplexArray, FloatArray

#: Standard deviation of the sampled white noise at remnant gain 1, calibrated so that
#: the paper's scale holds with the inferred filter of `Remnant`: gain 0.1 gives
#: var(n)/var(u) = 3 %, gain 0.8 about 32 %.
UNIT_LEVEL = 1.75

Place = Literal["control", "error", "neuromuscular"]
Shape = Literal["low-pass", "band-pass", "notch", "two processes", "fractional"]


@dataclass(frozen=True)
class Remnant:
    """White noise through a filter, a low-pass of order 0 (white) to 3 unless said.

    The white noise is white in the samples and band-limited to half the sampling
    rate.  The low-pass has unit gain at rest; order 1 is 1/(1 + s/w), order 2
    w^2/(s^2 + 2 z w s + w^2), order 3 their product.

    Attributes
    ----------
    order, frequency, damping
        Order, break frequency w [rad/s] and damping z of the low-pass.
    level
        The remnant gain, or the power ratio, as `level_is` says.
    level_is
        ``gain`` on the paper's scale, or ``ratio``: var(n)/var(u) at the control.
    enters
        ``control`` (added to u), ``neuromuscular`` (added before the neuromuscular system,
        which shapes it), or ``error`` (added to what the pilot sees, so that the visual
        channel shapes it).
    shape
        ``low-pass``; ``band-pass``, the low-pass times a first-order high-pass at `second`,
        down to a hundredth; ``notch``, the low-pass with a dip to a fifth at `second`;
        ``two processes``, the low-pass and an independent narrow band at `second`, of damping
        0.2 and a quarter of its low-frequency amplitude at the peak; ``fractional``,
        1/(1 + s/w) to the power `slope`.
    second
        Second frequency [rad/s] of the shapes that have one.
    slope
        Power of the fractional shape.
    freedom
        Degrees of freedom of the white noise's Student distribution; None for a Gaussian one.
    """

    order: int = 2
    frequency: float = 3.5
    damping: float = 0.7
    level: float = 0.4
    level_is: Literal["gain", "ratio"] = "gain"
    enters: Place = "control"
    shape: Shape = "low-pass"
    second: float = 1.0
    slope: float = 1.5
    freedom: float | None = None

    def __post_init__(self) -> None:
        if self.order not in (0, 1, 2, 3):
            raise ValueError(f"the remnant filter must be of order 0 to 3, not {self.order}")
        if self.level < 0.0 or (self.level_is == "ratio" and self.level >= 1.0):
            raise ValueError(f"a remnant {self.level_is} of {self.level:g} makes no sense")
        if self.shape not in get_args(Shape):
            raise ValueError(f"the remnant's shape must be one of {', '.join(get_args(Shape))}")
        if self.freedom is not None and self.freedom <= 2.0:
            raise ValueError("a remnant needs more than 2 degrees of freedom to have a variance")

    @property
    def shaped_by(self) -> tuple[str, ...]:
        """The attributes that shape the spectrum of a low-pass; none for other shapes."""
        if self.shape != "low-pass":
            return ()
        return ((), ("frequency",), ("frequency", "damping"), ("frequency", "damping"))[self.order]

    def filter(self, omega: FloatArray) -> ComplexArray:
        """Frequency response of the shaping filter, shape (n,)."""
        s = 1j * np.asarray(omega, dtype=float)
        if self.shape == "fractional":
            return np.asarray((1.0 + s / self.frequency) ** -self.slope)
        low_pass = self._low_pass(s)
        w = self.second
        match self.shape:
            case "band-pass":
                # A hundredth is left at rest, so that the spectrum has a logarithm.
                return np.asarray(low_pass * (s + 0.01 * w) / (s + w))
            case "notch":
                return np.asarray(
                    low_pass * (s * s + 0.2 * w * s + w * w) / (s * s + 1.0 * w * s + w * w)
                )
            case "two processes":
                # At the peak this is 1/4 in amplitude, since 2 z = 0.4.
                band = 0.25 * 0.4 * w * s / (s * s + 0.4 * w * s + w * w)
                # Powers of independent processes add; of the phase nothing depends.
                return np.asarray(np.hypot(np.abs(low_pass), np.abs(band)) + 0j)
            case _:
                return low_pass

    def _low_pass(self, s: ComplexArray) -> ComplexArray:
        first = 1.0 / (1.0 + s / self.frequency)
        w = self.frequency
        second = w * w / (s * s + 2.0 * self.damping * w * s + w * w)
        return (np.ones_like(s), first, second, first * second)[self.order]

    def white_noise(self, rng: np.random.Generator, shape: tuple[int, int]) -> FloatArray:
        """The noise that drives it, of variance 1, shape (runs, samples).

        Parameters
        ----------
        rng
            Draws it.
        shape
            Runs and samples.
        """
        if self.freedom is None:
            return rng.standard_normal(shape)
        scale = math.sqrt((self.freedom - 2.0) / self.freedom)
        return np.asarray(scale * rng.standard_t(self.freedom, shape))


@dataclass(frozen=True)
class TabulatedRemnant(Remnant):
    """A remnant at the control of any spectrum.

    Attributes
    ----------
    order, frequency, damping, level, level_is, enters, shape, second, slope
        Those of `Remnant` say nothing of it.
    freedom
        As of `Remnant`.
    omega
        Frequencies [rad/s], ascending.
    density
        One-sided power spectral density there [unit of u, squared, per rad/s]; between them it is
        interpolated, below the first constant, and above the last zero.
    coefficients, band
        Numbers by which a method estimates the spectrum's shape up to a frequency [rad/s] along
        with the pilot, for bounds; 0 for a spectrum that is known.
    """

    omega: tuple[float, ...] = ()
    density: tuple[float, ...] = ()
    coefficients: int = 0
    band: float = 0.0

    @property
    def shaped_by(self) -> tuple[str, ...]:
        """None."""
        return ()

    def filter(self, omega: FloatArray) -> ComplexArray:
        """Root of the density at `omega` [rad/s], shape (n,); powers depend on no phase."""
        log_density = np.interp(omega, self.omega, np.log(self.density), right=-math.inf)
        return np.asarray(np.exp(0.5 * log_density) + 0j)

    def log_slopes(self, omega: FloatArray) -> FloatArray:
        """Derivatives of ln(density) by cepstral coefficients, shape (coefficients, n)."""
        orders = np.arange(1, self.coefficients + 1)
        turn = np.pi * np.clip(omega / self.band, 0.0, 1.0) if self.band else np.zeros_like(omega)
        return np.asarray(np.cos(np.outer(orders, turn)))


def white(ratio: float) -> Remnant:
    """White remnant at the control, set by its power ratio var(n)/var(u)."""
    return Remnant(order=0, level=ratio, level_is="ratio")
