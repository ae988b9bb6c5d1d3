"""The lines of multisine forcing functions, given or found."""

from __future__ import annotations

import numpy as np

from pilotid.recordings.recording import Recording
from pilotid.recordings.remembered import remembered
from pilotid.types import FloatArray, IntArray

#: A bin is a line if its amplitude is at least this share of the largest one.
SMALLEST = 1e-3
#: A multisine leaves most of the bins between its first and last line to the remnant.
CROWDED = 0.34


class NotMultisineError(Exception):
    """A forcing function is no multisine with a whole number of periods; says what it is."""


@remembered
def forcing_lines(recording: Recording) -> dict[str, IntArray]:
    """Lines of the forcing functions, as multiples of 2 pi / T of the measurement window.

    They are those that the recording names, or else the bins that hold power.

    Returns
    -------
    Ascending lines by signal, ``ft`` and ``fd``, without those that do not force.

    Raises
    ------
    NotMultisineError
        If a forcing function is not periodic in the window, or no sum of a few sines.
    """
    found = {}
    for name in ("ft", "fd"):
        given, signal = recording.lines.get(name), getattr(recording, name)
        if given:
            lines = np.unique(np.array(given, dtype=int))
            if lines[0] < 1 or lines[-1] >= recording.samples / 2:
                raise NotMultisineError(
                    f"the lines of {name} must lie between 1 and half the number of samples"
                )
        elif signal is not None:
            lines = _found(name, recording.window(signal))
        else:
            continue
        if lines.size:
            found[name] = lines
    return found


def _found(name: str, signal: FloatArray) -> IntArray:
    power = np.mean(np.abs(np.fft.rfft(signal)[:, 1:-1]) ** 2, axis=0)
    # A constant leaves rounding errors.
    if power.max() <= (1e-12 * signal.shape[1] * np.max(np.abs(signal), initial=0.0)) ** 2:
        return np.zeros(0, dtype=int)
    lines = 1 + np.flatnonzero(power >= SMALLEST**2 * power.max())
    rest = power.sum() - power[lines - 1].sum()
    if lines.size > max(2.0, CROWDED * lines[-1]) or rest > 1e-3 * power.sum():
        raise NotMultisineError(
            f"{name} is no multisine with whole periods in the measurement window: "
            f"{lines.size} of the {lines[-1]} bins up to its highest hold power"
        )
    return lines
