"""Recorders: what stands between a loop and the file of it.

All signals pass one anti-alias filter; noise is added to each, a converter rounds it, and a text
file rounds it again.  A laboratory records the error or makes it of target and output.  Faulty
recorders filter some signals only, record some late, lose samples, or take them at times that
jitter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pilotid.recording.recording import SIGNALS, Recording
from pilotid.support.numbers import rms
from pilotid.support.types import FloatArray, IntArray

#: A loop is simulated so many times as fast as it is recorded, so that the filter is that of
#: continuous signals.
FASTER = 4


@dataclass(frozen=True)
class Recorder:
    """A chain from signals to numbers in a file.

    Attributes
    ----------
    order, corner
        Butterworth anti-alias filter of all signals: its order, 0 for none, and its corner as a
        share of half the sampling rate.
    noise
        Standard deviation of white noise on e, u and x, as a share of the signal's root mean
        square.
    bits, headroom
        Bits of the converter of e, u and x, 0 for none, and its range over the signal's peak.
    decimals
        Digits behind the point of a text file, of a signal whose peak is 1; 0 for a binary file.
    makes_error
        Whether the error is made of the target and the recorded output, or recorded.
    filtered
        Signals that pass the filter.
    smoothed
        Corner of a fourth-order low-pass without phase that all signals pass afterwards [Hz].
    late
        Signals that are recorded late, and by how many samples.
    lost
        Share of the samples of e, u and x that are replaced by the one before.
    jitter
        Standard deviation of the times of samples, as a share of the interval.
    """

    order: int = 0
    corner: float = 0.6
    noise: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bits: int = 0
    headroom: float = 2.0
    decimals: int = 0
    makes_error: bool = False
    filtered: tuple[str, ...] = tuple(SIGNALS)
    smoothed: float = 0.0
    late: tuple[tuple[str, int], ...] = ()
    lost: float = 0.0
    jitter: float = 0.0

    def recorded(self, loop: Recording, rng: np.random.Generator) -> Recording:
        """What a file holds of a loop that was simulated `FASTER` times as fast.

        Parameters
        ----------
        loop
            The signals.
        rng
            Draws the noise.
        """
        at = np.arange(loop.run_in % FASTER, loop.u.shape[1], FASTER)
        if self.jitter:
            moved = at + FASTER * self.jitter * rng.standard_normal(at.size)
            at = np.clip(np.round(moved).astype(int), 0, loop.u.shape[1] - 1)
        signals = {name: self._sampled(name, getattr(loop, name), at) for name in SIGNALS}
        if self.smoothed:
            from scipy.signal import butter, sosfiltfilt

            sections = butter(4, self.smoothed, fs=1.0 / (FASTER * loop.dt), output="sos")
            signals = {n: np.asarray(sosfiltfilt(sections, s, axis=1)) for n, s in signals.items()}
        for name, noise in zip(("e", "u", "x"), self.noise, strict=True):
            drawn = noise * rms(signals[name]) * rng.standard_normal(signals[name].shape)
            signals[name] = self._rounded(signals[name] + drawn, in_file=False)
        for name, count in self.late:
            signals[name] = np.roll(signals[name], count, axis=1)
            signals[name][:, :count] = signals[name][:, count : count + 1]
        if self.lost:
            kept = rng.random(at.size) >= self.lost
            kept[0] = True
            last = np.maximum.accumulate(np.where(kept, np.arange(at.size), 0))
            signals |= {name: signals[name][:, last] for name in ("e", "u", "x")}
        if self.makes_error:
            signals["e"] = signals["ft"] - signals["x"]
        written: dict[str, Any] = {n: self._rounded(s, in_file=True) for n, s in signals.items()}
        return replace(loop, dt=FASTER * loop.dt, run_in=loop.run_in // FASTER, **written)

    def _sampled(self, name: str, signal: FloatArray, at: IntArray) -> FloatArray:
        if self.order and name in self.filtered:
            from scipy.signal import butter, sosfilt, sosfilt_zi

            sections = butter(self.order, self.corner / FASTER, output="sos")
            start = sosfilt_zi(sections)[:, None] * signal[None, :, :1]
            signal = np.asarray(sosfilt(sections, signal, axis=1, zi=start)[0])
        return signal[:, at]

    def _rounded(self, signal: FloatArray, *, in_file: bool) -> FloatArray:
        """A signal behind the converter, or in the text file."""
        peak = float(np.abs(signal).max())
        if not (self.decimals if in_file else self.bits) or peak == 0.0:
            return signal
        step = 2.0 * self.headroom * peak / 2**self.bits
        if in_file:
            step = 10.0 ** (math.floor(math.log10(peak)) - self.decimals)
        return np.asarray(step * np.round(signal / step))


def drawn_recorder(rng: np.random.Generator) -> Recorder:
    """A recorder at random, of those that laboratories have."""
    noise = 10.0 ** rng.uniform(-5.0, -3.0, 3) * (rng.random(3) < 0.5)
    return Recorder(
        order=int(rng.choice([0, 2, 4])),
        corner=float(rng.uniform(0.4, 0.9)),
        noise=(float(noise[0]), float(noise[1]), float(noise[2])),
        bits=int(rng.choice([0, 0, 12, 14, 16])),
        headroom=float(rng.uniform(1.2, 5.0)),
        decimals=int(rng.choice([0, 3, 4, 5])),
        makes_error=bool(rng.random() < 0.5),
    )
