"""What all file formats share: signal names, the time base, words for messages."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from pilotid.recordings.recording import SIGNALS, is_unit
from pilotid.types import FloatArray, InputError

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

    def shown(self, names: Iterable[str]) -> str:
        """Where the signal was found, in words that --map would take."""
        return ", ".join(f"{'-' if self.flipped else ''}{name}" for name in names)


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


_UNIT = re.compile(r"(.*\S)\s*(?:\[([^\[\]]*)\]|\(([^()]*[^()0-9][^()]*|1)\))", re.DOTALL)


def bare(name: str) -> tuple[str, str | None]:
    """A name without its unit, and the unit: ``t [s]`` and ``u (deg)`` have one."""
    match = _UNIT.fullmatch(name)
    if match is None:
        return name, None
    unit = (match[2] if match[3] is None else match[3]).strip()
    return (match[1], unit) if is_unit(unit) else (name, None)


def matching(wanted: str, names: Iterable[str]) -> list[str]:
    """The names that may be meant by one: itself, else with a unit, else in other case.

    More than one means that it cannot be told.
    """
    known = list(names)
    for same in (
        lambda name: name == wanted,
        lambda name: bare(name)[0] == wanted,
        lambda name: bare(name)[0].casefold() == wanted.casefold(),
    ):
        if found := [name for name in known if same(name)]:
            return found
    return []


def required(places: Mapping[str, Place], found: Iterable[str], *, timed: bool) -> list[str]:
    """The signals that a file lacks and must have.

    Time may follow from a sampling interval (`timed`); e and x follow from one another and the
    target, and x is needed by channels of motion alone.
    """
    there = set(found)
    lacking = [s for s, place in places.items() if place.chosen and s not in there]
    for signal in ("t", "e", "u"):
        derived = (signal == "t" and timed) or (signal == "e" and {"ft", "x"} <= there)
        if signal not in there and not derived and signal not in lacking:
            lacking.append(signal)
    # With others missing, a user who must name them should hear of this one as well.
    if lacking and "x" not in there and "x" not in lacking and "ft" not in there:
        lacking.append("x")
    return sorted(lacking, key=list(NAMES).index)


def lacking(
    absent: Iterable[str], places: Mapping[str, Place], names: Iterable[str], kind: str
) -> str:
    """What a file lacks and how to mend it, all in one: "no column 'u' for u (control), ..."."""
    signals = list(absent)
    if len(signals) == 1:
        (signal,) = signals
        what = f"no {kind} {shown(places[signal].name)} for {signal} ({NAMES[signal]})"
    else:
        what = f"no {kind}s {', '.join(shown(places[s].name) for s in signals)}"
    picks = ",".join(f"{s}={kind.upper()}" for s in signals)
    which = "the right one" if len(signals) == 1 else "them"
    sentence = f"{what}, only {listed(names)}; name {which} with --map {picks}"
    if "t" in signals and not places["t"].chosen:
        sentence += ", or for want of t give --dt 0.01, say"
    return sentence


#: Seconds in a unit of time.
TIMES = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "microseconds"), 1e-6),
}


def seconds_in(unit: str | None, source: str) -> float:
    """How long the unit of the time is [s]; seconds where none is said.

    Raises
    ------
    InputError
        If the unit is unknown.
    """
    if not unit or unit == "-":
        return 1.0
    if unit.casefold() not in TIMES:
        raise InputError(
            f"{source}: the unit of the time is {shown(unit)}; give the time in s, ms or us"
        )
    return TIMES[unit.casefold()]


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
