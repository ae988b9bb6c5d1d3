"""Prediction of the control by a pilot whose gain and lead vary in time.

Such a channel's input is multiplied by functions of time before anything else happens to it.
A product in time is none in frequency, so the inputs are kept as samples, fine enough that a
step falls between two of them without harm, and modulated, low-passed as all other signals are
and transformed for every parameter set.  Delay and neuromuscular system act as ever.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pilotid.pilot.changing import Changing
from pilotid.pilot.model import Channel
from pilotid.recordings.recording import Recording
from pilotid.time_domain.extension import _extended
from pilotid.time_domain.prepare import decimation, derivative_kernel, lowpass
from pilotid.types import ComplexArray, FloatArray, IntArray

#: Longest interval between samples of the inputs that are modulated [s].  A change at the highest
#: rate, 100 1/s, is sampled so finely that its middle is known between samples.
FINEST = 0.02


@dataclass(frozen=True, eq=False)
class FineInput:
    """The input of a channel that varies in time, beyond both ends of the recording.

    Attributes
    ----------
    signals
        The signed input and its derivatives, shape (order + 1, runs, samples); the samples are
        those of the whole transform, a few for each of its own.
    time
        From the start of the measurement window [s], shape (samples,).
    smoothing
        Response of the low-pass filter that all signals pass through at the bins of the
        transform, over the number of fine samples a sample, shape (bins,).
    """

    signals: FloatArray
    time: FloatArray
    smoothing: FloatArray

    def modulated(self, changing: Changing, values: FloatArray) -> ComplexArray:
        """The transform of the modulated input, shape (sets, runs, bins).

        Parameters
        ----------
        changing, values
            What varies, and sets of its parameters, shape (sets, parameters).
        """
        weights = changing.weights(self.time, values)
        parts = [w[:, None] * signal for w, signal in zip(weights, self.signals, strict=True)]
        return self._spectrum(sum(parts[1:], parts[0]))

    def modulated_slopes(
        self, changing: Changing, values: FloatArray
    ) -> tuple[ComplexArray, ComplexArray]:
        """As `modulated`, and its derivatives, shape (sets, parameters, runs, bins)."""
        signal, slopes = changing.modulated(self.signals, self.time, values)
        return self._spectrum(signal), self._spectrum(slopes)

    def of_runs(self, runs: list[int]) -> FineInput:
        """The input of some runs alone."""
        return FineInput(self.signals[:, runs], self.time, self.smoothing)

    def _spectrum(self, signal: FloatArray) -> ComplexArray:
        bins = self.smoothing.size
        return np.asarray(np.fft.rfft(signal)[..., :bins] * self.smoothing)


def fine_input(
    recording: Recording,
    channel: Channel,
    start: float,
    span: tuple[int, int, int],
    band: float | None,
) -> FineInput:
    """The input of a channel in fine samples.

    Parameters
    ----------
    recording, channel
        What is prepared.
    start
        Time of the first prepared sample [s].
    span
        Prepared samples, samples by which they are extended at both ends, and length of the
        transform.
    band
        The analysis band [rad/s], None for the full rate.
    """
    assert channel.changing is not None
    count, extension, length = span
    factor = decimation(recording.dt, band)
    step = max(d for d in range(1, factor + 1) if factor % d == 0 and fine_enough(d, recording.dt))
    ratio, dt = factor // step, step * recording.dt
    reach = (derivative_kernel(channel.derivative, lowpass(step)).size - 1) // 2
    recorded = recording.input(channel.input)
    first = round((start - recording.time[0]) / recording.dt)
    last = first + (count - 1) * factor
    # What lies beyond the prepared samples is known as far as the low-pass of those reaches.
    wanted = math.ceil((lowpass(factor).size - 1) / 2 / step)
    before = min(wanted, (first - reach) // step)
    after = min(wanted, (recorded.shape[1] - 1 - reach - last) // step)
    places = np.arange(first - before * step, last + after * step + 1, step)
    around = places[:, None] + np.arange(-reach, reach + 1)

    def filtered(signal: FloatArray, order: int, at: IntArray) -> FloatArray:
        own = derivative_kernel(order, lowpass(step)) / recording.dt**order
        inner = (own.size - 1) // 2
        return np.asarray(signal[:, at[:, reach - inner : reach + inner + 1]] @ own[::-1])

    signal = filtered(recorded, channel.derivative, around)
    centred, ends = recorded - recorded.mean(axis=1, keepdims=True), around[[0, -1]]
    edges = np.array([filtered(centred, order, ends).T for order in range(channel.derivative)])
    edges = edges.reshape(channel.derivative, 2, recording.runs)
    outside = extension * ratio - max(before, after)
    extended = _extended(signal, edges, outside, dt)
    whole = np.zeros((recording.runs, length * ratio))
    lead = extension * ratio - before - outside
    whole[:, lead : lead + extended.shape[1]] = extended
    time = start + (np.arange(whole.shape[1]) - extension * ratio) * dt
    omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(whole.shape[1], dt), dtype=float)
    spectrum = channel.sign * np.fft.rfft(whole)
    signals = np.array(
        [
            np.fft.irfft((1j * omega) ** order * spectrum, n=whole.shape[1])
            for order in range(channel.changing.order + 1)
        ]
    )
    taps = lowpass(factor)
    lags = (np.arange(taps.size) - (taps.size - 1) // 2) * recording.dt
    bins = length // 2 + 1
    smoothing = np.cos(np.outer(omega[:bins], lags)) @ taps / ratio
    return FineInput(signals, np.asarray(time), np.asarray(smoothing))


def fine_enough(step: int, dt: float) -> bool:
    """Whether every so many samples are enough."""
    return step == 1 or step * dt <= FINEST * (1.0 + 1e-9)
