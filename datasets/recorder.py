"""Recorders: what stands between a loop and the file of it.

All signals pass one anti-alias filter; noise is added to each, a converter rounds it, and a text
file rounds it again.  A laboratory records the error or makes it of target and output.  Faulty
recorders filter some signals only, record some late, lose samples, or take them at times that
jitter.  Below, what scenarios take from a recording: its forcing functions, remnant and recorder.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pilotid.datasets.signals import Multisine, TabulatedRemnant
from pilotid.estimate.quantities import RemnantEstimate
from pilotid.recording.recording import SIGNALS, Recording
from pilotid.recording.spectra import floors_of, known_lines
from pilotid.support.types import FloatArray, InputError, IntArray

#: A loop is simulated so many times as fast as it is recorded, so that the filter is that of
#: continuous signals.
FASTER = 4
#: rms of the difference of two signals, over their own, up to which they are the same.
SAME_SIGNAL = 0.02
RETURN_SECONDS = 5.0  # seconds in which a signal without whole periods returns to where it began
SMALLEST_LINE = 1e-3  # a line is kept if its amplitude is at least this share of the largest one
FAINT = 1e-4  # share of a signal's rms below which a recorder's noise is left out


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
            drawn = noise * _rms(signals[name]) * rng.standard_normal(signals[name].shape)
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


def _rms(signal: FloatArray) -> float:
    return float(np.sqrt(np.mean(signal**2)))


def recorded_forcing(recording: Recording, name: str) -> Multisine | None:
    """A forcing function of a recording, None where there is none.

    One without whole periods in the window is a sum of sines too, over a period a little longer
    than the recording.

    Parameters
    ----------
    recording
        The recording; a target that was not recorded is e + x.
    name
        ``ft`` or ``fd``.

    Raises
    ------
    InputError
        If it differs from run to run.
    """
    signal = recording.input("ft") if name == "ft" else recording.fd
    if signal is None or _rms(signal) <= 1e-9 * _rms(recording.e if name == "ft" else recording.u):
        return None
    mean = np.mean(signal, axis=0)
    if _rms(signal - mean) > SAME_SIGNAL * _rms(mean):
        raise InputError(
            f"{recording.source}: {name} differs from run to run, so that its runs have no common "
            "scenario; give one run, or runs with the same forcing functions"
        )
    if (lines := known_lines(recording).get(name)) is not None:
        window = mean[recording.run_in :]
        sines = _sines(window, recording.dt, 0.0, lines)
        if _rms(sines.at(recording.time) + window.mean() - mean) <= SAME_SIGNAL * _rms(mean):
            return sines
    turn = np.linspace(0.0, math.pi, round(RETURN_SECONDS / recording.dt), endpoint=False)[1:]
    back = mean[-1] + (mean[0] - mean[-1]) * 0.5 * (1.0 - np.cos(turn))
    return _sines(np.append(mean, back), recording.dt, float(recording.time[0]))


def _sines(signal: FloatArray, dt: float, begin: float, lines: IntArray | None = None) -> Multisine:
    """A sampled period that begins at a time [s], without its mean: at lines, or all that count."""
    phasors = 2j * np.fft.rfft(signal)[1 : (signal.size + 1) // 2] / signal.size
    if lines is None:
        lines = 1 + np.flatnonzero(np.abs(phasors) >= SMALLEST_LINE * np.abs(phasors).max())
    kept = phasors[lines - 1] * np.exp(-2j * math.pi * lines * begin / (signal.size * dt))
    size, phase = np.abs(kept).tolist(), np.angle(kept).tolist()
    return Multisine(tuple(lines.tolist()), tuple(size), tuple(phase), signal.size * dt)


def recorded_remnant(
    remnant: RemnantEstimate, recording: Recording, to_control: Callable[[FloatArray], FloatArray]
) -> TabulatedRemnant:
    """The remnant by its estimated spectrum; above the band by that of the recorded control.

    Parameters
    ----------
    remnant
        The estimate.
    recording
        The recording.
    to_control
        Power of the control for each unit of the remnant's, at frequencies [rad/s].
    """
    floors, nyquist = floors_of(recording), 1.001 * math.pi / recording.dt
    above = floors.omega > remnant.omega[-1]
    omega = np.concatenate([remnant.omega, floors.omega[above]])
    beyond = floors.power["u"][above] / to_control(floors.omega[above])
    density = np.concatenate([remnant.density, beyond])
    density = np.maximum(density, 1e-12 * density.max())
    return TabulatedRemnant(
        omega=(*omega.tolist(), nyquist),
        density=(*density.tolist(), float(density[-1])),
        coefficients=len(remnant.parameters),
        band=float(remnant.omega[-1]),
    )


def recorded_noise(recording: Recording) -> Recorder | None:
    """A recorder with the floors of e and x; that of u is part of the remnant's spectrum."""
    floor, nyquist = floors_of(recording).floor, math.pi / recording.dt
    made = _rms(recording.e + recording.x - recording.input("ft")) < FAINT * _rms(recording.e)
    made = made and recording.ft is not None
    error, output = (
        math.sqrt(floor[name] * nyquist) / max(_rms(getattr(recording, name)), 1e-300)
        for name in ("e", "x")
    )
    noise = (0.0 if made or error < FAINT else error, 0.0, 0.0 if output < FAINT else output)
    return Recorder(noise=noise, makes_error=made) if any(noise) else None
