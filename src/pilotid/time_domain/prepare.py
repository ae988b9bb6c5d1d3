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
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.types import FloatArray, InputError

SHORTEST_SCORED = 3.0  # seconds that must remain to be scored
DIFFERENCE_REACH = 12  # samples on either side that a central difference uses
ATTENUATION = 50.0  # dB, of the low-pass filter
TRANSITION = 0.35  # width of its transition, as a share of the band


@dataclass(frozen=True, eq=False)
class Prepared:
    """Signals of a recording on the analysis grid.

    Attributes
    ----------
    dt
        Sampling interval after decimation [s].
    inputs
        Per channel, its input (or the derivative it acts on), pre-history included;
        shape (runs, samples).
    edges
        Per channel, the lower derivatives of its input at the first and last sample,
        from the input itself (less its mean) upwards; shape (derivative, 2, runs).
    control
        The control on the same samples, shape (runs, samples).
    first
        Index of the first scored sample.
    time
        Time of the samples [s], shape (samples,).
    """

    dt: float
    inputs: tuple[FloatArray, ...]
    edges: tuple[FloatArray, ...]
    control: FloatArray
    first: int
    time: FloatArray


def decimation(dt: float, band: float | None) -> int:
    """Largest whole factor that keeps the band below half the new sampling rate."""
    return 1 if band is None else max(1, math.floor(math.pi / (band * dt) + 1e-9))


def prepare(
    recording: Recording,
    model: PilotModel,
    band: float | None = None,
    unscored: float | None = None,
) -> Prepared:
    """Filter, differentiate and decimate what the model's prediction needs.

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
    """
    factor = decimation(recording.dt, band)
    smoothing = lowpass(factor)
    highest = max(c.derivative for c in model.channels)
    kernels = {order: derivative_kernel(order, smoothing) for order in range(highest + 1)}
    half = max((k.size - 1) // 2 for k in kernels.values())

    total = recording.u.shape[1]
    lead_in = recording.lead_in if unscored is None else unscored
    first_scored = max(recording.run_in, round(lead_in / recording.dt), half)
    if total - 1 - half - first_scored < SHORTEST_SCORED / recording.dt:
        raise InputError(
            f"{recording.source}: {total * recording.dt:.3g} s of recording leave less than "
            f"{SHORTEST_SCORED:g} s to score in the analysis band; "
            "use a longer recording or a wider band"
        )
    before = (first_scored - half) // factor
    after = (total - 1 - half - first_scored) // factor
    centres = slice(first_scored - before * factor, first_scored + after * factor + 1, factor)

    def filtered(signal: FloatArray, order: int, step: int = factor) -> FloatArray:
        kernel = kernels[order] / recording.dt**order
        if kernel.size == 1:
            return np.asarray(kernel[0] * signal[:, centres.start : centres.stop : step])
        reach = (kernel.size - 1) // 2
        windows = sliding_window_view(signal, kernel.size, axis=1)
        # Correlation, so the kernel is turned round.
        windows = windows[:, centres.start - reach : centres.stop - reach : step]
        return np.asarray(windows @ kernel[::-1])

    def edges(signal: FloatArray, order: int) -> FloatArray:
        signal = signal - signal.mean(axis=1, keepdims=True)
        span = centres.stop - 1 - centres.start
        rows = [filtered(signal, lower, span).T for lower in range(order)]
        return np.array(rows).reshape(order, 2, recording.runs)

    return Prepared(
        dt=recording.dt * factor,
        inputs=tuple(filtered(recording.input(c.input), c.derivative) for c in model.channels),
        edges=tuple(edges(recording.input(c.input), c.derivative) for c in model.channels),
        control=filtered(recording.u, 0),
        first=before,
        time=recording.time[centres],
    )


@lru_cache
def lowpass(factor: int) -> FloatArray:
    """Kaiser low-pass with its -6 dB point at half the decimated sampling rate."""
    if factor == 1:
        return np.ones(1)
    cutoff = math.pi / factor  # rad per sample
    width = TRANSITION * cutoff
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


def derivative_kernel(order: int, smoothing: FloatArray) -> FloatArray:
    """Convolution kernel of a low-pass filter and a derivative, per sample^order."""
    if order == 0:
        return smoothing
    return np.convolve(smoothing, _difference(order)[::-1])
