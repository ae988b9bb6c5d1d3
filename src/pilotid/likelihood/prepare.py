"""Preparation of a recording for prediction: filter, differentiate, decimate.

All signals pass through one linear-phase low-pass filter, of which only the valid
part is kept, and are decimated to the analysis band.  A filter common to all
signals commutes with a linear time-invariant pilot, so that the model is as true
of the prepared signals as of the recorded ones.  Derivatives of an input, which
motion channels act on, are taken in the same step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import count
from math import factorial

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.support.types import FloatArray, InputError


def pad(signal: FloatArray, edges: FloatArray, extension: int, dt: float) -> FloatArray:
    """Continue a signal beyond both ends, faded to zero.

    Parameters
    ----------
    signal
        The signal, shape (runs, samples).
    edges
        What it is the derivative of, at the first and last sample, from the lowest
        derivative upwards; shape (derivative, 2, runs), empty for a signal itself.
    extension
        Samples to add at each end.
    dt
        Sampling interval [s].
    """
    order = len(edges)
    # Going back in time, odd derivatives change their sign.
    signs = (-1.0) ** np.arange(order + 1)
    lower = signs[:order, None] * edges[:, 0]
    left = signs[order] * _pad_beyond_end(signs[order] * signal, lower, extension, dt)
    right = _pad_beyond_end(signal[:, ::-1], edges[:, 1], extension, dt)
    return np.concatenate([left[:, ::-1], signal, right], axis=1)


def _pad_beyond_end(inward: FloatArray, lower: FloatArray, extension: int, dt: float) -> FloatArray:
    """Continuation of a signal beyond its first sample, in the direction away from it.

    Odd reflection, since a jump would ring into the scored part, where whitening
    magnifies it.  The continuation of a derivative (an acceleration, say) must moreover
    bring the signal underneath to rest from where the recording shows it: slow dynamics
    (canals) would otherwise start from a state that the recording contradicts.

    Parameters
    ----------
    inward
        The signal from its end inwards, shape (runs, samples).
    lower
        Lower derivatives at the end, in outward time, shape (derivative, runs).
    extension
        Samples to add.
    dt
        Sampling interval [s].
    """
    time = np.arange(1, extension + 1) * dt
    span = time[-1] + dt
    fade = 0.5 * (1.0 + np.cos(np.pi * time / span))
    outward = (2.0 * inward[:, :1] - inward[:, 1 : extension + 1]) * fade
    order = len(lower)
    if order == 0:
        return np.asarray(outward)
    # f^(order-j)(span) = sum_i f^(order-j+i)(0) span^i/i! + int (span-t)^(j-1)/(j-1)! f^(order)
    kernels = np.array([(span - time) ** (j - 1) / factorial(j - 1) for j in range(1, order + 1)])
    bumps = np.sin(np.pi * time / span) ** 2 * (time / span) ** np.arange(order)[:, None]
    at_rest = np.zeros((order, inward.shape[0]))
    for j in range(1, order + 1):
        start = sum(lower[order - j + i] * span**i / factorial(i) for i in range(j))
        half = 0.5 * span ** (j - 1) / factorial(j - 1) * inward[:, 0]
        at_rest[j - 1] = -start - dt * (outward @ kernels[j - 1] + half)
    weights = np.linalg.solve(dt * kernels @ bumps.T, at_rest)
    return np.asarray(outward + weights.T @ bumps)


def fast_length(samples: int) -> int:
    """The shortest length of a fast real transform, a product of 2, 3 and 5, of so many samples.

    scipy has the same as ``next_fast_len``, but takes longer to import than a fit takes.
    """
    return next(n for n in count(max(samples, 1)) if _is_product(n, (2, 3, 5)))


def _is_product(number: int, primes: tuple[int, ...]) -> bool:
    for prime in primes:
        while number % prime == 0:
            number //= prime
    return number == 1


MIN_SCORED = 3.0  # seconds that must remain to be scored
DIFFERENCE_REACH = 12  # samples on either side that a central difference uses
ATTENUATION = 50.0  # dB, of the low-pass filter


def decimation(dt: float, band: float | None) -> int:
    """Largest whole factor that keeps the band below half the new sampling rate."""
    return 1 if band is None else max(1, math.floor(math.pi / (band * dt) + 1e-9))


class Prepared:
    """Signals of a recording on the analysis grid: filtered, differentiated, decimated.

    Parameters
    ----------
    recording
        The recording.
    model
        Says which inputs, and which derivatives of them, are needed.
    band
        Analysis band [rad/s]; None keeps the full sampling rate, unfiltered.
    unscored
        Least length of the pre-history [s]; a run-in counts towards it.  None for that which the
        recording names (`Recording.lead_in`).
    fast
        Whether a few of the last samples are left out (at most 4 % of 300, 2.5 % of 500 or more),
        so that transforms of the window are fast: large prime factors make them slow.
    """

    def __init__(
        self,
        recording: Recording,
        model: PilotModel,
        band: float | None = None,
        unscored: float | None = None,
        *,
        fast: bool = False,
    ) -> None:
        factor = decimation(recording.dt, band)
        half = half_width(max(c.derivative for c in model.channels), factor)
        total = recording.u.shape[1]
        lead_in = recording.lead_in if unscored is None else unscored
        first_scored = max(recording.run_in, round(lead_in / recording.dt), half)
        # At the end as many samples are not scored as a model looks ahead.
        unseen = round(model.ahead / recording.dt)
        if total - 1 - half - first_scored - unseen < MIN_SCORED / recording.dt:
            raise InputError(
                f"{recording.source}: {total * recording.dt:.3g} s of recording leave less than "
                f"{MIN_SCORED:g} s to score in the analysis band; "
                "use a longer recording or a wider band"
            )
        scored = (total - 1 - half - first_scored - unseen) // factor + 1
        if fast and band is not None:
            scored = next(n for n in range(scored, 0, -1) if _is_product(n, (2, 3, 5, 7, 11)))
        #: Sampling interval after decimation [s].
        self.dt = recording.dt * factor
        #: Index of the first scored sample, and how many there are.
        self.first, self.scored = (first_scored - half) // factor, scored
        after = (total - 1 - half - first_scored) // factor
        start, stop = first_scored - self.first * factor, first_scored + after * factor + 1
        centres = slice(start, stop, factor)
        #: Time of the samples [s], shape (samples,).
        self.time = recording.time[centres]
        #: The control, shape (runs, samples).
        self.control = derivative(recording.u, 0, factor, recording.dt, centres)
        channels = [(recording.input(c.on), c.derivative) for c in model.channels]
        #: Per channel, its input (or the derivative it acts on), of the same shape.
        self.inputs = [derivative(*channel, factor, recording.dt, centres) for channel in channels]
        #: Per channel, the lower derivatives of its input at the first and last sample, from the
        #: input itself (less its mean) upwards; shape (derivative, 2, runs).
        self.edges = [edges(*channel, factor, recording.dt, centres) for channel in channels]


@lru_cache
def lowpass(factor: int) -> FloatArray:
    """Kaiser low-pass with its -6 dB point at half the decimated sampling rate."""
    if factor == 1:
        return np.ones(1)
    cutoff = math.pi / factor  # rad per sample
    width = 0.35 * cutoff  # of the transition
    reach = math.ceil((ATTENUATION - 8.0) / (2.285 * width) / 2.0)
    beta = 0.1102 * (ATTENUATION - 8.7)
    k = np.arange(-reach, reach + 1)
    taps = np.sinc(cutoff / np.pi * k) * np.kaiser(k.size, beta)
    return np.asarray(taps / taps.sum())


@lru_cache
def _difference(order: int) -> FloatArray:
    """Central difference of the highest accuracy that its length allows, per sample.

    Flat up to about half the Nyquist frequency, where a pilot has no power left.
    """
    k = np.arange(-DIFFERENCE_REACH, DIFFERENCE_REACH + 1, dtype=float)
    # Moments of order j must vanish but for j = order; scaled for conditioning.
    scaled = k / DIFFERENCE_REACH
    moments = np.vander(scaled, k.size, increasing=True).T
    target = np.zeros(k.size)
    target[order] = math.factorial(order) / DIFFERENCE_REACH**order
    weights = np.linalg.solve(moments, target)
    # Exact symmetry, which rounding in the solution misses by a little.
    return np.asarray(0.5 * (weights + (-1.0) ** order * weights[::-1]))


def _kernel(order: int, factor: int) -> FloatArray:
    """Convolution kernel of a low-pass filter and a derivative, per sample^order."""
    smoothing = lowpass(factor)
    return smoothing if order == 0 else np.convolve(smoothing, _difference(order)[::-1])


def half_width(order: int, factor: int) -> int:
    """Samples on either side that a derivative behind the filter of a decimation takes."""
    return (_kernel(order, factor).size - 1) // 2


def derivative(signal: FloatArray, order: int, factor: int, dt: float, places: slice) -> FloatArray:
    """A derivative of a signal, behind the low-pass filter of a decimation.

    Parameters
    ----------
    signal
        The signal as recorded, shape (runs, samples).
    order
        Order of the derivative, 0 for the signal itself.
    factor, dt
        Factor of the decimation, and sampling interval of the recording [s].
    places
        Which samples of it are wanted.
    """
    kernel = _kernel(order, factor) / dt**order
    if kernel.size == 1:
        return np.asarray(kernel[0] * signal[:, places])
    reach = (kernel.size - 1) // 2
    windows = sliding_window_view(signal, kernel.size, axis=1)
    # Correlation, so the kernel is turned round.
    windows = windows[:, places.start - reach : places.stop - reach : places.step]
    return np.asarray(windows @ kernel[::-1])


def edges(signal: FloatArray, order: int, factor: int, dt: float, places: slice) -> FloatArray:
    """What is below a derivative, at the first and the last sample, shape (order, 2, runs).

    It is `derivative` of the orders below, of the signal less its mean.
    """
    centred = signal - signal.mean(axis=1, keepdims=True)
    ends = slice(places.start, places.stop, places.stop - 1 - places.start)
    rows = [derivative(centred, lower, factor, dt, ends).T for lower in range(order)]
    return np.array(rows).reshape(order, 2, len(signal))


#: Samples that a whitening filter may reach back, and that one may to whom low frequencies matter.
REACH, FAR = 20, 60


def prediction_error_filters(autocovariance: FloatArray) -> FloatArray:
    """Prediction-error filters by Levinson's and Durbin's recursion, shape (sets, lags).

    Parameters
    ----------
    autocovariance
        Lags from 0, shape (sets, lags).
    """
    sets, lags = autocovariance.shape
    taps = np.zeros((sets, lags))
    taps[:, 0] = 1.0
    power = autocovariance[:, 0].copy()
    for order in range(1, lags):
        across = np.einsum("sk,sk->s", taps[:, :order], autocovariance[:, order:0:-1])
        reflection = -across / power
        taps[:, 1 : order + 1] += reflection[:, None] * taps[:, order - 1 :: -1][:, :order]
        power = power * (1.0 - reflection * reflection)
    return taps


GRID = 256  # frequencies on which spectra of noise models are integrated


@dataclass(frozen=True)
class Band:
    """The analysis band: sampling interval of a recording, and factor of decimation."""

    recorded_dt: float
    factor: int

    @property
    def dt(self) -> float:
        """Sampling interval after decimation [s]."""
        return self.recorded_dt * self.factor

    @property
    def limit(self) -> float | None:
        """The band as `Prepared` takes it [rad/s]; None for the full sampling rate."""
        return None if self.factor == 1 else math.pi / self.dt

    @cached_property
    def omega(self) -> FloatArray:
        """Frequencies inside the band [rad/s], shape (grid,)."""
        return np.asarray((np.arange(GRID) + 0.5) * (np.pi / (GRID * self.dt)), dtype=float)

    @cached_property
    def cosines(self) -> FloatArray:
        """Maps a spectrum on `omega` to autocovariances, shape (grid, FAR + 1)."""
        return np.asarray(np.cos(np.outer(self.omega * self.dt, np.arange(FAR + 1))) / GRID)

    @cached_property
    def folded(self) -> tuple[FloatArray, FloatArray]:
        """Frequencies that decimation folds into the band, and what maps spectra there.

        It maps to autocovariances behind the low-pass filter.
        """
        if self.factor == 1:
            return self.omega, self.cosines
        omega = np.concatenate([self.omega, 2.0 * np.pi / self.dt - self.omega])
        taps = lowpass(self.factor)
        k = np.arange(taps.size) - taps.size // 2
        power = (np.cos(np.outer(omega * self.recorded_dt, k)) @ taps) ** 2
        return omega, power[:, None] * np.tile(self.cosines, (2, 1))

    def autocovariance(self, power: FloatArray, reach: int) -> FloatArray:
        """Autocovariances up to lag `reach` of spectra (..., n) at all frequencies of `folded`."""
        return np.asarray(power @ self.folded[1][:, : reach + 1])


@lru_cache
def analysis_band(dt: float, band: float | None) -> Band:
    """The analysis band up to `band` [rad/s], or all, of a recording sampled every `dt` [s]."""
    return Band(dt, decimation(dt, band))
