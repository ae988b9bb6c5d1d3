"""What drives a loop: forcing functions, target and disturbance, and the remnant.

A forcing function knows its samples at any time and the exact response of any
stable transfer function to it: a multisine line by line, steps by their exact
Fourier coefficients.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pilotid.support.types import ComplexArray, FloatArray

Response = Callable[[FloatArray], ComplexArray]
PERIOD = 81.92  # measurement window of AIAA 2008-7109 [s]
AT_ONCE = 256  # lines whose samples are held in memory together
#: Standard deviation of the sampled white noise at remnant gain 1, calibrated so that
#: the paper's scale holds with the inferred filter of `Remnant`: gain 0.1 gives
#: var(n)/var(u) = 3 %, gain 0.8 about 32 %.
UNIT_LEVEL = 1.75

Place = Literal["control", "neuromuscular"]
Shape = Literal["low-pass", "band-pass", "notch", "two processes", "fractional"]


class Forcing:
    """A deterministic signal and its exact passage through a linear system."""

    def at(self, time: FloatArray) -> FloatArray:
        """The signal at `time` [s], both of shape (times,)."""
        return self.through(np.ones_like, time)

    def through(self, response: Response, time: FloatArray) -> FloatArray:
        """What stable systems with these frequency responses answer, at `time` [s].

        Parameters
        ----------
        response
            Maps frequencies [rad/s], shape (n,), to responses, shape (..., n).
        time
            Shape (times,); answers have the shape (..., times).
        """
        raise NotImplementedError


@dataclass(frozen=True)
class Multisine(Forcing):
    """Sum of sines sum_i A_i sin(k_i w0 t + phi_i), w0 = 2 pi / period.

    Attributes
    ----------
    lines, amplitudes, phases
        Line numbers k_i, amplitudes [signal's unit] and phases [rad].
    period
        Period of line 1 [s].
    """

    lines: tuple[int, ...]
    amplitudes: tuple[float, ...]
    phases: tuple[float, ...]
    period: float = PERIOD

    def __post_init__(self) -> None:
        if not len(self.lines) == len(self.amplitudes) == len(self.phases):
            raise ValueError("a multisine needs as many amplitudes and phases as lines")
        if len(set(self.lines)) != len(self.lines) or min(self.lines, default=1) < 1:
            raise ValueError("the lines of a multisine must be different whole numbers >= 1")

    @property
    def omega(self) -> FloatArray:
        """Frequencies of the lines [rad/s], shape (lines,)."""
        return 2.0 * np.pi * np.array(self.lines, dtype=float) / self.period

    def through(self, response: Response, time: FloatArray) -> FloatArray:
        """What systems with these responses answer, see `Forcing.through`."""
        omega = self.omega
        phasors = np.array(self.amplitudes) * np.exp(1j * np.array(self.phases)) * response(omega)
        parts = [
            np.imag(phasors[..., i : i + AT_ONCE] @ np.exp(1j * np.outer(some, time)))
            for i in range(0, omega.size, AT_ONCE)
            for some in (omega[i : i + AT_ONCE],)
        ]
        return np.asarray(sum(parts[1:], parts[0]))

    def scaled(self, gain: float) -> Multisine:
        """The same signal times a gain."""
        return replace(self, amplitudes=tuple(gain * a for a in self.amplitudes))

    def with_random_phases(self, rng: np.random.Generator) -> Multisine:
        """The same spectrum with phases drawn uniformly."""
        phases = rng.uniform(-np.pi, np.pi, len(self.lines))
        return replace(self, phases=tuple(float(p) for p in phases))


@dataclass(frozen=True)
class Steps(Forcing):
    """A piecewise constant signal, zero before its first jump.

    Signals are recorded behind an anti-aliasing filter, flat up to 60 % of half the
    sampling rate, zero at half the rate, without phase.  All signals of a recording pass
    through it, so that it leaves the pilot's response as it is; without it the sampled
    jump would hold the frequencies above half the rate too, and bias every estimate.

    Attributes
    ----------
    times, jumps
        When [s] and by how much the signal jumps.
    """

    times: tuple[float, ...]
    jumps: tuple[float, ...]

    # Response by Fourier series: the signal returns to zero after the last sample and rests
    # so long [s] that the system forgets it within one period.
    settle = 150.0
    flat = 0.6

    def through(self, response: Response, time: FloatArray) -> FloatArray:
        """What systems with these responses answer, see `Forcing.through`."""
        from scipy.fft import irfft, next_fast_len

        dt, first = float(time[1] - time[0]), float(time[0])
        count = next_fast_len(time.size + int(np.ceil(self.settle / dt)), real=True)
        period = count * dt
        end = float(time[-1]) + 0.5 * self.settle
        times = np.array([*self.times, end]) - first
        jumps = np.array([*self.jumps, -sum(self.jumps)])
        omega = 2.0 * np.pi * np.arange(count // 2 + 1, dtype=float) / period
        coefficients = np.zeros(omega.size, dtype=complex)
        coefficients[1:] = (jumps @ np.exp(-1j * np.outer(times, omega[1:]))) / (
            1j * omega[1:] * period
        )
        coefficients[0] = -(jumps @ times) / period  # mean of the signal over the period
        coefficients *= anti_aliasing(omega, dt)
        answer = irfft(coefficients * response(omega) * count, n=count)
        return np.asarray(answer[..., : time.size])


def paper_target() -> Multisine:
    """The target forcing function of AIAA 2008-7109, Table 2 [deg]."""
    return _sines(
        (6, 9, 13, 19, 29, 47, 61, 83, 107, 139, 179, 213),
        (0.0876, 0.0764, 0.0613, 0.043, 0.025, 0.012)
        + (0.0081, 0.0052, 0.0038, 0.0029, 0.0024, 0.0021),
    )


def paper_disturbance() -> Multisine:
    """The disturbance forcing function of AIAA 2008-7109, Table 2, at the control."""
    return _sines(
        (5, 8, 11, 17, 28, 46, 59, 82, 106, 137, 178, 211),
        (0.0031, 0.0071, 0.0115, 0.0193, 0.0284, 0.0363)
        + (0.0407, 0.0488, 0.059, 0.0755, 0.1033, 0.1308),
    )


def adaptation_target() -> Multisine:
    """The target in roll of Zaal (JGCD 39(5) 2016), Table 1 [deg]."""
    return Multisine(
        (3, 5, 8, 13, 22, 34, 53, 86, 139, 229),
        (1.186, 1.121, 0.991, 0.756, 0.447, 0.245, 0.123, 0.061, 0.036, 0.025),
        (0.974, -3.026, 0.744, -2.3, 2.984, -2.513, 2.211, 1.004, -2.255, 2.21),
    )


def half_and_half_step(duration: float, size: float = 1.0) -> Steps:
    """A positive step for the first half of the run, a negative one for the second.

    Parameters
    ----------
    duration
        Length of the run [s].
    size
        Of the step, in the signal's unit.
    """
    return Steps((0.0, duration / 2.0), (size, -2.0 * size))


def anti_aliasing(omega: FloatArray, dt: float) -> FloatArray:
    """Response of the recorder's anti-aliasing filter at `omega` [rad/s]."""
    share = np.clip((omega * dt / np.pi - Steps.flat) / (1.0 - Steps.flat), 0.0, 1.0)
    return np.asarray(0.5 * (1.0 + np.cos(np.pi * share)))


def _sines(lines: Sequence[int], amplitudes: Sequence[float]) -> Multisine:
    return Multisine(tuple(lines), tuple(amplitudes), (0.0,) * len(lines))


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
        ``control`` (added to u), or ``neuromuscular`` (added before the neuromuscular system,
        which shapes it).
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
        if self.freedom is not None and self.freedom <= 2.0:
            raise ValueError("a remnant needs more than 2 degrees of freedom to have a variance")

    def log_slopes(self, omega: FloatArray) -> FloatArray:
        """Derivatives of ln(density) by what shapes a low-pass, shape (parameters, n).

        Parameters
        ----------
        omega
            Frequencies [rad/s], shape (n,).
        """
        names = ("frequency", "damping")[: self.order] if self.shape == "low-pass" else ()
        slopes = np.zeros((len(names), omega.size))
        for slope, name in zip(slopes, names, strict=True):
            step = 1e-5 * getattr(self, name)
            ahead, behind = (
                replace(self, **{name: getattr(self, name) + h}).filter(omega)
                for h in (step, -step)
            )
            slope += np.log(np.abs(ahead / behind)) / step  # of the power: twice the amplitude's
        return slopes

    def filter(self, omega: FloatArray) -> ComplexArray:
        """Frequency response of the shaping filter, shape (n,)."""
        s, w = 1j * np.asarray(omega, dtype=float), self.frequency
        first = 1.0 / (1.0 + s / w)
        second = w * w / (s * s + 2.0 * self.damping * w * s + w * w)
        low_pass = (np.ones_like(s), first, second, first * second)[self.order]
        w = self.second
        match self.shape:
            case "fractional":
                return np.asarray((1.0 + s / self.frequency) ** -self.slope)
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

    def filter(self, omega: FloatArray) -> ComplexArray:
        """Root of the density at `omega` [rad/s], shape (n,); powers depend on no phase."""
        log_density = np.interp(omega, self.omega, np.log(self.density), right=-math.inf)
        return np.asarray(np.exp(0.5 * log_density) + 0j)

    def log_slopes(self, omega: FloatArray) -> FloatArray:
        """Derivatives of ln(density) by cepstral coefficients, shape (coefficients, n)."""
        orders = np.arange(1, self.coefficients + 1)
        turn = np.pi * np.clip(omega / self.band, 0.0, 1.0) if self.band else np.zeros_like(omega)
        return np.asarray(np.cos(np.outer(orders, turn)))


def samples_of(forcing: Forcing | None, time: FloatArray) -> FloatArray:
    """A forcing function at `time` [s], both of shape (times,); zeros for none."""
    return np.zeros(time.size) if forcing is None else forcing.at(time)


def white(ratio: float) -> Remnant:
    """White remnant at the control, set by its power ratio var(n)/var(u)."""
    return Remnant(order=0, level=ratio, level_is="ratio")
