"""What was understood of a recording, as plain data."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from pilotid.recordings.plant import plant_of
from pilotid.recordings.recording import SIGNALS, Recording
from pilotid.recordings.spectra import NotMultisineError, answers, lines_of

REST = 0.2  # seconds at one value from which a control rests
LACKING = {
    "e": "no model can be fitted",
    "x": "models with a channel on x cannot be fitted",
    "ft": "lines of a target are unknown",
    "fd": "lines of a disturbance are unknown",
}


@dataclass(frozen=True)
class Signal:
    """One signal.

    Attributes
    ----------
    name, meaning
        Ours.
    origin
        Its name in the file, or what it follows from.
    unit
        Empty if unsaid.
    rms, smallest, largest
        Over the measurement window of all runs.
    """

    name: str
    meaning: str
    origin: str
    unit: str
    rms: float
    smallest: float
    largest: float


@dataclass(frozen=True)
class Forcing:
    """What is known of one forcing function.

    Attributes
    ----------
    name
        ``ft`` or ``fd``.
    lines
        Multiples of `base`; empty if it is no multisine.
    base
        2 pi / T of the measurement window [rad/s].
    lowest, highest
        Range of the lines [rad/s], None without lines.
    given
        Whether the file names the lines; else they were found.
    answered, coherence
        At how many lines the control stands out of its noise, and the median share of its power
        at the lines that is no noise; None where it is not known.
    why
        Why there are no lines, empty if there are.
    """

    name: str
    lines: tuple[int, ...]
    base: float
    lowest: float | None
    highest: float | None
    given: bool
    answered: int | None
    coherence: float | None
    why: str


@dataclass(frozen=True)
class Understood:
    """What was understood of a recording.

    Attributes
    ----------
    runs, rate, duration, run_in
        Number of runs, sampling rate [Hz], length of the measurement window and of the run-in [s].
    unscored
        Seconds at the beginning of the window that methods in the time domain do not score.
    signals, missing
        What is there, and what is not, with what that means.
    forcing
        The forcing functions that are there.
    rest
        Share of the time that the control keeps one value for 0.2 s or longer.
    element_coherence
        Mean squared coherence of x with u + fd, 1 for an element without noise; None if unknown.
    controlled_element
        What the file says of it.
    """

    runs: int
    rate: float
    duration: float
    run_in: float
    unscored: float
    signals: tuple[Signal, ...]
    missing: dict[str, str]
    forcing: tuple[Forcing, ...]
    rest: float
    element_coherence: float | None
    controlled_element: str

    def to_dict(self) -> dict[str, object]:
        """Plain objects, as JSON has them."""
        return asdict(self)


def understood(recording: Recording) -> Understood:
    """What was understood of a recording."""
    plant = plant_of(recording)
    run_in = recording.run_in * recording.dt
    return Understood(
        runs=recording.runs,
        rate=1.0 / recording.dt,
        duration=recording.duration,
        run_in=run_in,
        unscored=max(0.0, recording.lead_in - run_in),
        signals=tuple(_signal(recording, name) for name in recording.signals),
        missing={n: why for n, why in LACKING.items() if n not in recording.signals},
        forcing=_forcing(recording),
        rest=_rest(recording),
        element_coherence=None if plant is None else plant.mean_coherence,
        controlled_element=recording.controlled_element,
    )


def _signal(recording: Recording, name: str) -> Signal:
    window = recording.window(recording.input(name))
    return Signal(
        name,
        SIGNALS.get(name, "extra signal"),
        recording.origin.get(name, name),
        recording.units.get(name, ""),
        float(np.sqrt(np.mean(window**2))),
        float(window.min()),
        float(window.max()),
    )


def _forcing(recording: Recording) -> tuple[Forcing, ...]:
    base = 2.0 * np.pi / recording.duration
    answered = answers(recording)
    found = []
    for name in ("ft", "fd"):
        given = name in recording.lines
        if getattr(recording, name) is None and not given:
            continue
        lines, why = [], "it does not move"
        try:
            lines = lines_of(recording, name).tolist()
        except NotMultisineError as error:
            why = str(error)
        answer = answered.get(name)
        found.append(
            Forcing(
                name,
                tuple(lines),
                base,
                lines[0] * base if lines else None,
                lines[-1] * base if lines else None,
                given,
                None if answer is None else answer.loud,
                None if answer is None else float(np.median(answer.coherence)),
                "" if lines else why,
            )
        )
    return tuple(found)


def _rest(recording: Recording) -> float:
    """Share of the steps of the control that belong to a rest."""
    window = recording.window(recording.u)
    resting = 0
    for row in window:
        moves = np.flatnonzero(np.diff(row) != 0.0)
        edges = np.concatenate([[-1], moves, [row.size - 1]])
        still = np.diff(edges) - 1  # steps without a change between two changes
        resting += int(still[still * recording.dt >= REST].sum())
    return resting / float(window.shape[0] * (window.shape[1] - 1))
