"""What all file formats share: signal names, the time base, words for messages."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from pilotid.recordings.recording import SIGNALS
from pilotid.types import FloatArray, InputError

REQUIRED = ("t", "e", "u", "x")
NAMES = {"t": "time", **SIGNALS}
UNEVENNESS = 0.1  # of a sampling interval: time stamps rounded to milliseconds pass at 100 Hz
SNAP = 1e-4  # relative: a rate this close to a whole number of hertz is that number
SLOWEST = 1.0  # seconds; such an interval means a time in milliseconds, not a pilot
FASTEST = 1e-6  # seconds; ten seconds of such samples could not be held
MOST_VALUES = 2**25  # of all signals; ten minutes at 1 kHz in ten runs are 31 million
LATEST = 1e12  # seconds; such a time is counted in a smaller unit


@dataclass(frozen=True)
class Place:
    """Where a file keeps a signal.

    Attributes
    ----------
    name
        Column or variable.
    flipped
        Whether the file holds the signal with the opposite sign.
    chosen
        Whether the user named it, so that it must exist.
    """

    name: str
    flipped: bool = False
    chosen: bool = False

    def signed(self, values: FloatArray) -> FloatArray:
        """The values with the sign of our convention."""
        return -values if self.flipped else values


def signal_places(mapping: Mapping[str, str] | None) -> dict[str, Place]:
    """The place of every signal: the user's choice, or its own name.

    Raises
    ------
    InputError
        For a signal that does not exist or a choice that names nothing.
    """
    places = {signal: Place(signal) for signal in NAMES}
    for signal, choice in (mapping or {}).items():
        if signal not in NAMES:
            raise InputError(
                f"the mapping {signal}={choice} names the unknown signal {shown(signal)}; "
                f"on the left of = use one of {', '.join(NAMES)}"
            )
        choice = choice.strip()
        name = choice.removeprefix("-").strip()
        if not name:
            raise InputError(
                f"the mapping {signal}={choice} names nothing; write {signal}=NAME with the "
                "file's name for that signal"
            )
        places[signal] = Place(name, flipped=choice.startswith("-"), chosen=True)
    return places


@dataclass(frozen=True)
class TimeBase:
    """Sampling interval [s] and number of samples before t = 0."""

    dt: float
    run_in: int


def time_base(t: FloatArray, source: str, where: Callable[[int], str]) -> TimeBase:
    """The uniform time base of the times `t`, shape (samples,).

    Raises
    ------
    InputError
        If the times do not increase evenly; `where` puts a sample's index into words.
    """
    if t.size < 2:
        raise InputError(f"{source}: holds {t.size} samples; at least 10 s are needed")
    if np.abs(t).max() > LATEST:
        late = int(np.argmax(np.abs(t)))
        raise InputError(
            f"{source}: the time is {t[late]:.4g} s at {where(late)}; give the time in seconds"
        )
    steps = np.diff(t)
    if steps.min() <= 0.0:
        raise InputError(
            f"{source}: the time does not increase at {where(int(np.argmax(steps <= 0.0)) + 1)}; "
            "remove repeated rows, and give repeated runs a column or a run number each"
        )
    dt = float(t[-1] - t[0]) / (t.size - 1)
    if not FASTEST <= dt < SLOWEST:
        raise InputError(
            f"{source}: the sampling interval is {dt:.4g} s; give the time in seconds and at least "
            "a few samples a second"
        )
    if np.abs(t - np.linspace(t[0], t[-1], t.size)).max() > UNEVENNESS * dt:
        usual = float(np.median(steps))
        worst = int(np.argmax(np.abs(steps - usual)))
        raise InputError(
            f"{source}: the time steps by {steps[worst]:.6g} s at {where(worst + 1)} but by "
            f"{usual:.6g} s elsewhere; resample the recording to even steps"
        )
    rate = round(1.0 / dt)
    if abs(dt * rate - 1.0) <= SNAP:
        dt = 1.0 / rate
    return TimeBase(dt, int(np.count_nonzero(t < -UNEVENNESS * dt)))


def shown(text: object) -> str:
    """A text from a file, quoted for a message: one line, not too long."""
    words = " ".join(str(text).split())
    return repr(words if len(words) <= 40 else f"{words[:40]}...")


def listed(names: Iterable[object]) -> str:
    """Names found in a file, for a message."""
    texts = [shown(name)[1:-1] for name in names]
    return ", ".join(texts[:20] + ["..."] * (len(texts) > 20)) or "none"
