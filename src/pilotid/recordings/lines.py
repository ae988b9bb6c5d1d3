"""The lines of multisine forcing functions, given or found, and what signals hold there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pilotid.recordings.recording import Recording, remembered
from pilotid.remarks import Remark
from pilotid.types import ComplexArray, FloatArray, IntArray

#: A bin is a line if its amplitude is at least this share of the largest one.
SMALLEST = 1e-3
#: A multisine leaves most of the bins between its first and last line to the remnant.
CROWDED = 0.34
FEWEST = 5  # lines of a target that tell which signal is which
MEDIAN = 0.64  # of the power of eight bins of noise less their own median, over its mean
BESIDE = 8  # bins beside a line that tell leakage and noise in it
LOUD = 4.0  # times the noise from which a line of one run stands out
LONG = 60.0  # seconds from which lines and remnant can be told apart
ANSWERED = 0.5  # by which the median ratio exceeds one in one run; sound ones have 0.9 and more


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


@dataclass(frozen=True, eq=False)
class Answer:
    """The control at the lines of one forcing function.

    Attributes
    ----------
    lines
        Multiples of 2 pi / T, shape (lines,).
    coherence
        Share of the control's power there that is not noise, shape (lines,).
    ratios
        Power there over that of the noise, shape (lines,).
    runs
        Of how many runs powers are means.
    """

    lines: IntArray
    coherence: FloatArray
    ratios: FloatArray
    runs: int

    @property
    def loud(self) -> int:
        """Number of lines that stand out of the noise."""
        loud = 1.0 + (LOUD - 1.0) / np.sqrt(self.runs)  # chance scatters less in a mean of runs
        return int(np.count_nonzero(self.coherence > 1.0 - 1.0 / loud))


def answers(recording: Recording) -> dict[str, Answer]:
    """How the control answers to each forcing function that is a multisine, by its name."""
    try:
        every = forcing_lines(recording)
    except NotMultisineError:
        return {}
    found = {}
    for name, lines in every.items():
        control, beside = _beside(recording, recording.u, lines, every)
        # Medians: lines of a forcing function that was not recorded may lie among them.
        leaked = np.median(beside.real, axis=2) + 1j * np.median(beside.imag, axis=2)
        noise = np.mean(np.median(np.abs(beside - leaked[..., None]) ** 2, axis=2), axis=0) / MEDIAN
        noise += 1e-12 * np.max(np.abs(control)) ** 2
        ratio = np.mean(np.abs(control - leaked) ** 2, axis=0) / noise
        found[name] = Answer(lines, 1.0 - 1.0 / np.maximum(ratio, 1.0), ratio, recording.runs)
    return found


def unanswered(recording: Recording) -> Remark | None:
    """A control that holds nothing of the forcing functions identifies nobody."""
    if recording.duration < LONG:
        return None
    found = answers(recording)
    least = 1.0 + ANSWERED / np.sqrt(recording.runs)
    if not found or any(float(np.median(a.ratios)) > least for a in found.values()):
        return None
    which = " and ".join(found)
    return Remark(
        "forcing-unanswered",
        f"u does not answer to {which}: at the lines it is no larger than beside them (coherence "
        f"{max(float(np.median(a.coherence)) for a in found.values()):.2f}); u belongs to another "
        "run, or the remnant is too large to identify the pilot",
    )


def target_lines(recording: Recording) -> dict[str, IntArray] | None:
    """Lines of the forcing functions, None where the target's are too few to tell anything."""
    try:
        lines = forcing_lines(recording)
    except NotMultisineError:
        return None
    return lines if "ft" in lines and lines["ft"].size >= FEWEST else None


def at_lines(
    recording: Recording, signal: FloatArray, lines: IntArray, every: dict[str, IntArray]
) -> tuple[ComplexArray, FloatArray]:
    """Transforms of a signal at lines, shape (runs, lines), and the power of the noise there.

    What transients leak is smooth in frequency, so that the bins beside a line tell it.
    """
    values, beside = _beside(recording, signal, lines, every)
    noise = np.mean(np.var(beside, axis=2), axis=0) + 1e-12 * np.max(np.abs(values)) ** 2
    return values - beside.mean(axis=2), noise


def _beside(
    recording: Recording, signal: FloatArray, lines: IntArray, every: dict[str, IntArray]
) -> tuple[ComplexArray, ComplexArray]:
    """Transforms at lines, shape (runs, lines), and at the bins beside each, a third axis."""
    spectrum = np.fft.rfft(recording.window(signal))
    free = np.ones(spectrum.shape[1], dtype=bool)
    free[np.concatenate([[0], *every.values()])] = False
    between = np.flatnonzero(free)
    # The nearest are among so many on either side.
    first = np.searchsorted(between, lines) - BESIDE
    first = np.clip(first, 0, max(0, between.size - 2 * BESIDE))
    around = between[first[:, None] + np.arange(min(2 * BESIDE, between.size))]
    order = np.argsort(np.abs(around - lines[:, None]), axis=1, kind="stable")[:, :BESIDE]
    return spectrum[:, lines], spectrum[:, np.take_along_axis(around, order, axis=1)]
