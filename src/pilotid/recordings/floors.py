"""How far each signal of a recording stands above what the recorder adds.

A recorder adds noise and rounding, whose spectrum is flat: a floor, which shows near half the
sampling rate, where nobody moves a stick.  A frequency at which an input of the pilot is little
above its floor tells little of the pilot, and what it tells is wrong: the inputs are taken for
exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pilotid.recordings.recording import INPUTS, Recording, remembered
from pilotid.types import ComplexArray, FloatArray

#: Shares of half the sampling rate between which the floor is measured.
FLOOR_FROM, FLOOR_TO = 0.6, 0.95
#: Half the width of the running median that smooths a spectrum [rad/s]; a line of a forcing
#: function is one bin of many there, and does not count.
HALF_WIDTH = 0.75
#: Multiple of the floor that is taken off a spectrum.  The floor is known from few bins, and a
#: share of signal that is taken too large does more harm than one too small.
SAFE = 1.5


@dataclass(frozen=True, eq=False)
class Floors:
    """Spectra of signals, and the floors of the recorder.

    Attributes
    ----------
    omega
        Frequencies [rad/s], shape (n,).
    power
        Smoothed power density by signal, the unit of the signal squared per rad/s, shape (n,).
    floor
        The recorder's, of the same unit, by signal.
    variance
        Mean over runs, by signal.
    """

    omega: FloatArray
    power: dict[str, FloatArray]
    floor: dict[str, float]
    variance: dict[str, float]

    def share(self, names: tuple[str, ...]) -> FloatArray:
        """Share of the power of signals that is not the recorder's, of the worst, shape (n,).

        It falls with frequency from where it is largest: what follows a floor is no signal.
        """
        share = np.ones(self.omega.size)
        for name in names:
            above = 1.0 - SAFE * self.floor[name] / np.maximum(self.power[name], 1e-300)
            share = np.minimum(share, np.clip(above, 0.0, 1.0))
        largest = int(np.argmax(share))
        share[largest:] = np.minimum.accumulate(share[largest:])
        return share


@remembered
def floors_of(recording: Recording) -> Floors:
    """Spectra and floors of the signals that pilots act on, and of the control."""
    nyquist = math.pi / recording.dt
    signals = {INPUTS[name]: recording.input(name) for name in INPUTS} | {"u": recording.u}
    power, floor = {}, {}
    for name, signal in signals.items():
        density, step = periodogram(signal, recording.dt)
        omega, power[name] = running_median(density, step)
        top = slice(int(FLOOR_FROM * nyquist / step) + 1, int(FLOOR_TO * nyquist / step) + 1)
        floor[name] = float(density[:, top].mean())
    if recording.ft is not None:  # a target that steps has all frequencies, and is no noise
        own = periodogram(recording.e - recording.ft, recording.dt)[0][:, top]
        floor["e"] = min(floor["e"], float(own.mean()))
    variance = {name: float(np.mean(np.var(own, axis=1))) for name, own in signals.items()}
    return Floors(omega, power, floor, variance)


def periodogram(signals: FloatArray, dt: float) -> tuple[FloatArray, float]:
    """Power densities of signals (runs, samples) behind a Blackman-Harris window.

    Returns
    -------
    Densities, shape (runs, bins), and the distance of bins [rad/s].
    """
    samples = signals.shape[1]
    turn = 2.0 * np.pi * np.arange(samples) / samples
    window = 0.35875 - 0.48829 * np.cos(turn) + 0.14128 * np.cos(2 * turn)
    window -= 0.01168 * np.cos(3 * turn)
    window *= math.sqrt(dt / np.pi / float(window @ window))
    centred = signals - signals.mean(axis=1, keepdims=True)
    spectra: ComplexArray = np.fft.rfft(window * centred)
    return np.abs(spectra) ** 2, 2.0 * math.pi / (samples * dt)


def running_median(density: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Smoothed densities of all runs.

    The median of a periodogram of noise is ln 2 of its mean.

    Parameters
    ----------
    density
        Periodograms, shape (runs, bins).
    step
        Distance of bins [rad/s].

    Returns
    -------
    Frequencies [rad/s] and densities there, shape (n,).
    """
    reach = max(2, int(HALF_WIDTH / step))
    count = density.shape[1] // reach
    blocks = density[:, : count * reach].reshape(len(density), count, reach)
    pairs = np.concatenate([blocks[:, :-1], blocks[:, 1:]], axis=2)
    medians = np.median(pairs.transpose(1, 0, 2).reshape(count - 1, -1), axis=1)
    omega = (np.arange(1, count) * reach - 0.5) * step
    return omega, medians / math.log(2.0)
