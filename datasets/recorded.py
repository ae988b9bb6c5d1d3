"""What a scenario takes from a recording: forcing functions, remnant and recorder."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from pilotid.datasets.forcing import Multisine
from pilotid.datasets.recorder import Recorder
from pilotid.datasets.remnant import TabulatedRemnant
from pilotid.estimates.parts import RemnantEstimate
from pilotid.recordings.recording import Recording
from pilotid.recordings.spectra import NotMultisineError, floors_of, forcing_lines
from pilotid.types import FloatArray, InputError, IntArray

SAME = 0.02  # rms of the difference of two signals, over their own, up to which they are the same
RETURN = 5.0  # seconds in which a signal without whole periods returns to where it began
SMALLEST = 1e-3  # a line is kept if its amplitude is at least this share of the largest one
QUIET = 1e-4  # share of a signal's rms below which a recorder's noise is left out


def recorded_forcing(recording: Recording, name: str) -> tuple[Multisine | None, bool]:
    """A forcing function of a recording, and whether it has the other sign in every other run.

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
    signal = recording.input("target") if name == "ft" else recording.fd
    if signal is None or _rms(signal) <= 1e-9 * _rms(recording.e if name == "ft" else recording.u):
        return None, False
    signs = np.sign(signal @ signal[0])
    mean = np.mean(signs[:, None] * signal, axis=0)
    alternating = bool(np.any(signs < 0.0))
    expected = 1.0 - 2.0 * (np.arange(recording.runs) % 2) if alternating else 1.0
    if np.any(signs != expected) or _rms(signs[:, None] * signal - mean) > SAME * _rms(mean):
        raise InputError(
            f"{recording.source}: {name} differs from run to run, so that its runs have no common "
            "scenario; give one run, or runs with the same forcing functions"
        )
    try:
        lines = forcing_lines(recording).get(name)
    except NotMultisineError:
        lines = None
    if lines is not None:
        window = mean[recording.run_in :]
        sines = _sines(window, recording.dt, 0.0, lines)
        if _rms(sines.at(recording.time) + window.mean() - mean) <= SAME * _rms(mean):
            return sines, alternating
    turn = np.linspace(0.0, math.pi, round(RETURN / recording.dt), endpoint=False)[1:]
    back = mean[-1] + (mean[0] - mean[-1]) * 0.5 * (1.0 - np.cos(turn))
    return _sines(np.append(mean, back), recording.dt, float(recording.time[0])), alternating


def _sines(signal: FloatArray, dt: float, begin: float, lines: IntArray | None = None) -> Multisine:
    """A sampled period that begins at a time [s], without its mean: at lines, or all that count."""
    phasors = 2j * np.fft.rfft(signal)[1 : (signal.size + 1) // 2] / signal.size
    if lines is None:
        lines = 1 + np.flatnonzero(np.abs(phasors) >= SMALLEST * np.abs(phasors).max())
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
        omega=(*omega.tolist(), nyquist), density=(*density.tolist(), float(density[-1]))
    )


def recorded_noise(recording: Recording) -> Recorder | None:
    """A recorder with the floors of e and x; that of u is part of the remnant's spectrum."""
    floor, nyquist = floors_of(recording).floor, math.pi / recording.dt
    made = _rms(recording.e + recording.x - recording.input("target")) < QUIET * _rms(recording.e)
    made = made and recording.ft is not None
    error, output = (
        math.sqrt(floor[name] * nyquist) / max(_rms(getattr(recording, name)), 1e-300)
        for name in ("e", "x")
    )
    noise = (0.0 if made or error < QUIET else error, 0.0, 0.0 if output < QUIET else output)
    return Recorder(noise=noise, makes_error=made) if any(noise) else None


def _rms(signal: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(signal))))
