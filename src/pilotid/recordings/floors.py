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

from pilotid.recordings.recording import INPUTS, Recording
from pilotid.recordings.remembered import remembered
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
    """

    omega: FloatArray
    power: dict[str, FloatArray]
    floor: dict[str, float]

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
    omega = np.arange(0.0, math.pi / recording.dt, HALF_WIDTH)
    power, floor = {}, {}
    for name in dict.fromkeys((*INPUTS.values(), "u")):
        own = next((key for key, signal in INPUTS.items() if signal == name), None)
        if own == "target" and recording.ft is None:
            continue
        signal = recording.u if own is None else recording.input(own)
        density, step = periodogram(signal, recording.dt)
        power[name] = running_median(density, step, omega)
        nyquist = math.pi / recording.dt
        top = slice(int(FLOOR_FROM * nyquist / step) + 1, int(FLOOR_TO * nyquist / step) + 1)
        floor[name] = float(density[:, top].mean())
    return Floors(omega, power, floor)


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


def running_median(density: FloatArray, step: float, omega: FloatArray) -> FloatArray:
    """Smoothed density of all runs at some frequencies, shape (n,).

    The median of a periodogram of noise is ln 2 of its mean.

    Parameters
    ----------
    density
        Periodograms, shape (runs, bins).
    step
        Distance of bins [rad/s].
    omega
        Frequencies [rad/s], shape (n,).
    """
    reach = max(2, int(HALF_WIDTH / step))
    at = np.minimum(np.round(omega / step).astype(int), density.shape[1] - 1)
    medians = [np.median(density[:, max(0, i - reach) : i + reach + 1]) for i in at.tolist()]
    return np.asarray(medians) / math.log(2.0)
