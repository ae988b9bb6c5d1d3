"""What a file holds: signals, times and notes about them; and the recording they make.

A format's reader turns a file into `Contents`; `assembled` makes the
`Recording` of it, so every check that does not depend on the format is here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pilotid.recordings.recording import (
    ABSENT,
    LONGEST_ELEMENT,
    LONGEST_UNIT,
    SIGNALS,
    Recording,
    factor_of,
    is_element,
    is_unit,
    require_extra_name,
    times,
)
from pilotid.support.types import SIGNAL_NAME, FloatArray, InputError

NAMES = {"t": "time", **SIGNALS}
UNEVENNESS = 0.1  # of a sampling interval: time stamps rounded to milliseconds pass at 100 Hz
SNAP = 1e-4  # relative: a rate this close to a whole number of hertz is that number
SLOWEST = 1.0  # seconds; such an interval means a time in milliseconds, not a pilot
FASTEST = 1e-6  # seconds; ten seconds of such samples could not be held
MOST_VALUES = 2**25  # of all signals; ten minutes at 1 kHz in ten runs are 31 million
LATEST = 1e12  # seconds; such a time is counted in a smaller unit
_UNIT = re.compile(r"(.*\S)\s*(?:\[([^\[\]]*)\]|\(([^()]*[^()0-9][^()]*|1)\))", re.DOTALL)
#: Seconds in a unit of time.
TIMES = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "microseconds"), 1e-6),
}
LARGEST = 1e15  # up to which a float holds every whole number
#: Magnitudes that instruments and programs write where they have no value; in single precision
#: they are a little off.
CODES = np.array(
    [999.0, 9999.0, 99999.0, 999999.0, 9999999.0, 32768.0, *(10.0**n for n in range(20, 38))]
)
HUGE = 1e38  # nothing that is measured is so large, but the largest numbers are so: 1e308
APART = 5.0  # times as large as anything else in the signal


@dataclass(frozen=True)
class Place:
    """Where a file keeps a signal.

    Attributes
    ----------
    name
        Column or variable.
    factor
        What the file's values are multiplied by.
    chosen
        Whether the user named it, so that it must exist.
    """

    name: str
    factor: float = 1.0
    chosen: bool = False

    def signed(self, values: FloatArray) -> FloatArray:
        """The values with sign and unit of our convention."""
        return values if self.factor == 1.0 else np.asarray(self.factor * values)

    def shown(self, names: Iterable[str]) -> str:
        """Where the signal was found, in words that --map would take."""
        return ", ".join(times(self.factor, name) for name in names)


def signal_places(mapping: Mapping[str, str] | None) -> dict[str, Place]:
    """The place of every signal: the user's choice, or its own name.

    What is not one of `NAMES` is an extra signal.

    Raises
    ------
    InputError
        For what cannot be the name of a signal, or a choice that names nothing.
    """
    places = {signal: Place(signal) for signal in NAMES}
    for signal, choice in (mapping or {}).items():
        if signal not in NAMES:
            require_extra_name(signal)
        factor, name = factor_of(choice)
        if not name or not (np.isfinite(factor) and factor):
            raise InputError(
                f"the mapping {signal}={choice} names nothing; write {signal}=NAME with the "
                f"file's name for that signal, or {signal}=-3.5*NAME"
            )
        places[signal] = Place(name, factor, chosen=True)
    return places


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
    return sorted(lacking, key=list(places).index)


def lacking(
    absent: Iterable[str], places: Mapping[str, Place], names: Iterable[str], kind: str
) -> str:
    """What a file lacks and how to mend it, all in one: "no column 'u' for u (control), ..."."""
    signals = list(absent)
    if len(signals) == 1:
        (signal,) = signals
        meaning = NAMES.get(signal, "extra signal")
        what = f"no {kind} {shown(places[signal].name)} for {signal} ({meaning})"
    else:
        what = f"no {kind}s {', '.join(shown(places[s].name) for s in signals)}"
    picks = ",".join(f"{s}={kind.upper()}" for s in signals)
    which = "the right one" if len(signals) == 1 else "them"
    sentence = f"{what}, only {listed(names)}; name {which} with --map {picks}"
    if "t" in signals and not places["t"].chosen:
        sentence += ", or for want of t give --dt 0.01, say"
    return sentence


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


def common_time(times: Mapping[str, FloatArray], source: str) -> FloatArray:
    """The time of all runs.

    Parameters
    ----------
    times
        Of each run, by what it is called in messages.
    source
        The file, for messages.

    Raises
    ------
    InputError
        If runs differ in length or time.
    """
    (name, first), *others = times.items()
    step = abs(float(first[-1] - first[0])) / max(1, first.size - 1)
    for other, time in others:
        if time.size != first.size:
            raise InputError(
                f"{source}: {other} has {time.size} samples but {name} has {first.size}; cut all "
                "runs to the same length"
            )
        if np.abs(time - first).max() > UNEVENNESS * step:
            raise InputError(
                f"{source}: the time of {other} differs from that of {name}; give every run the "
                "same times"
            )
    return first


def shown(text: object) -> str:
    """A text from a file, quoted for a message: one line, not too long."""
    words = " ".join(str(text).split())
    return repr(words if len(words) <= 40 else f"{words[:40]}...")


@dataclass(frozen=True)
class Parts:
    """The part of a file that is meant, as in ``F.mat::identification`` or ``F.csv::sigma=17``.

    Attributes
    ----------
    path
        Name of the struct, group or cell that holds the recording; empty for all.
    levels
        Values of variables or columns by whose values runs are chosen.
    """

    path: str = ""
    levels: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, texts: Sequence[str]) -> Parts:
        """The part that texts between ``::`` name."""
        pairs = [text.partition("=") for text in texts]
        levels = {name.strip(): value.strip() for name, equals, value in pairs if equals}
        return cls(".".join(name for name, equals, _ in pairs if not equals), levels)


def is_level(value: object, wanted: str) -> bool:
    """Whether a value in a file is the one in a text; numbers are compared as such."""
    try:
        return float(str(value)) == float(wanted)
    except ValueError:
        return str(value).strip() == wanted


def no_level(source: str, name: str, wanted: str, there: Iterable[object]) -> InputError:
    """The refusal of a value that no run has."""
    return InputError(
        f"{source}: no run has {shown(name)} = {shown(wanted)}; there are "
        f"{listed(level_text(value) for value in dict.fromkeys(there))}"
    )


def level_text(value: object) -> str:
    """A value as it is typed: whole numbers without a point."""
    return f"{value:.12g}" if isinstance(value, float) else str(value).strip()


def listed(names: Iterable[object]) -> str:
    """Names found in a file, for a message."""
    texts = [shown(name)[1:-1] for name in names]
    return ", ".join(texts[:20] + ["..."] * (len(texts) > 20)) or "none"


@dataclass(frozen=True)
class Notes:
    """What a file may say about its recording beside the signals; None is not said.

    Attributes
    ----------
    where
        The place of the notes themselves, for messages.
    runs, run_in, dt
        Number of runs, length of the run-in [s], sampling interval [s].
    units, lines, controlled_element
        As in `Recording`.
    extra
        Names of extra signals that the file holds by these names.
    """

    where: str = ""
    runs: int | None = None
    run_in: float | None = None
    dt: float | None = None
    units: Mapping[str, str] | None = None
    lines: Mapping[str, tuple[int, ...]] | None = None
    controlled_element: str | None = None
    extra: tuple[str, ...] | None = None

    @classmethod
    def parsed(cls, raw: object, where: str) -> Notes:
        """The notes in a plain object of numbers, strings, lists and mappings.

        Raises
        ------
        InputError
            For an unknown key or a value of the wrong kind.
        """
        if not isinstance(raw, dict):
            raise InputError(f"{where}: must be one object with keys among {', '.join(READERS)}")
        values: dict[str, Any] = {}
        named = {*SIGNALS, *(_extra(raw.get("extra", [])) or ())}
        for key, value in raw.items():
            if key not in READERS:
                raise InputError(
                    f"{where}: unknown key {shown(key)}; the known ones are {', '.join(READERS)} "
                    "(rename this file if it is not the description of the recording)"
                )
            read, wanted = READERS[key]
            values[key] = read(value)
            if values[key] is None or (key == "units" and not values[key].keys() <= named):
                raise InputError(f"{where}: {key!r} must be {wanted}; correct it or leave it out")
        return cls(where=where, **values)

    @classmethod
    def of(cls, recording: Recording, t: FloatArray, where: str) -> Notes:
        """The notes that, beside the times `t` as they are written, restore a recording."""
        base = time_base(t, where, lambda i: f"sample {i + 1}")
        return cls(
            where=where,
            runs=recording.runs,
            run_in=recording.run_in * recording.dt,
            dt=None if base.dt == recording.dt else recording.dt,
            units=dict(recording.units) or None,
            lines=dict(recording.lines) or None,
            controlled_element=recording.controlled_element or None,
            extra=tuple(recording.extra) or None,
        )

    def with_extra(self, places: Mapping[str, Place]) -> dict[str, Place]:
        """The places of signals, and of those that the notes name."""
        return {name: Place(name, chosen=True) for name in self.extra or ()} | {**places}

    def plain(self) -> dict[str, object]:
        """The inverse of `parsed`.

        Raises
        ------
        InputError
            If `parsed` would not take them, so that no unreadable file is written.
        """
        raw = {key: getattr(self, key) for key in READERS if getattr(self, key) is not None}
        if self.lines:
            raw["lines"] = {name: list(lines) for name, lines in self.lines.items()}
        if self.extra:
            raw["extra"] = list(self.extra)
        Notes.parsed(raw, self.where)
        return raw


def _seconds(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if 0 <= value < LARGEST else None


def _count(value: object) -> int | None:
    number = _seconds(value)
    return int(number) if number and number.is_integer() else None


def _units(value: object) -> dict[str, str] | None:
    return value if isinstance(value, dict) and all(map(is_unit, value.values())) else None


def _extra(value: object) -> tuple[str, ...] | None:
    try:
        for name in value if isinstance(value, list) else [value]:
            require_extra_name(name)
    except InputError:
        return None
    return tuple(value) if isinstance(value, list) else (str(value),)


def _lines(value: object) -> dict[str, tuple[int, ...]] | None:
    if not isinstance(value, dict) or not value.keys() <= {"ft", "fd"}:
        return None
    lines: dict[str, tuple[int, ...]] = {}
    for signal, entries in value.items():
        counts = [_count(entry) for entry in entries] if isinstance(entries, list) else [None]
        lines[signal] = tuple(count for count in counts if count is not None)
        if len(lines[signal]) < len(counts):
            return None
    return lines


def _element(value: object) -> str | None:
    return value if isinstance(value, str) and is_element(value) else None


#: What reads each of the notes, None for what it is not, and what it must be.
READERS: dict[str, tuple[Callable[[object], object], str]] = {
    "runs": (_count, "a whole number of at least 1"),
    "run_in": (_seconds, "a number of seconds, 0 or more"),
    "dt": (lambda value: _seconds(value) or None, "a positive number of seconds"),
    "units": (
        _units,
        f"an object of strings (at most {LONGEST_UNIT} printable characters without $), keys among "
        f"{', '.join(SIGNALS)} and those of extra",
    ),
    "lines": (_lines, "an object {'ft': [...], 'fd': [...]} of whole numbers"),
    "extra": (_extra, f"a list of names of extra signals: {SIGNAL_NAME}"),
    "controlled_element": (_element, f"a string of at most {LONGEST_ELEMENT} printable characters"),
}


@dataclass(frozen=True)
class Contents:
    """What a file holds.

    Attributes
    ----------
    t
        Time [s], shape (samples,); None if the file has none.
    signals
        By our names, each of shape (runs, samples), or (1, samples) for one that all runs share;
        in the precision of the file.
    where
        Puts the place of a sample of the time, by its index, into words.
    notes
        What the file says beside the signals.
    origin
        The file's names of the signals.
    """

    t: FloatArray | None
    signals: Mapping[str, FloatArray]
    where: Callable[[int], str]
    notes: Notes = field(default_factory=Notes)
    origin: Mapping[str, str] = field(default_factory=dict)


def assembled(contents: Contents, source: str, dt: float | None = None) -> Recording:
    """The recording that a file holds.

    Parameters
    ----------
    contents
        What the file holds; without e it must hold ft and x.
    source
        The file, for messages.
    dt
        Sampling interval [s], if the user gives it.

    Raises
    ------
    InputError
        If time base, signals and notes do not make one recording.
    """
    notes, signals, origin = contents.notes, dict(contents.signals), dict(contents.origin)
    for name, values in signals.items():
        refuse_codes(values, name, source)
    runs, samples = signals["u"].shape
    if notes.runs not in (None, runs):
        raise InputError(
            f"{notes.where}: says {notes.runs} runs but {source} holds {runs}; correct one of them"
        )
    for name, other in (("x", "e"), ("e", "x")):
        if name not in signals and {"ft", other} <= signals.keys():
            _require_shape(signals["ft"], signals[other], other, source)
            signals[name] = np.subtract(signals["ft"], signals[other], dtype=float)
            origin[name] = f"ft - {other}"
    if "x" not in signals:
        signals["x"] = np.zeros_like(signals["u"])
        origin["x"] = ABSENT
    base = _interval(contents, samples, source, dt)
    return Recording(
        dt=base.dt,
        e=signals["e"],
        u=signals["u"],
        x=signals["x"],
        ft=signals.get("ft"),
        fd=signals.get("fd"),
        run_in=_agreed_run_in(base.run_in, notes, base.dt, source),
        lines=notes.lines or {},
        units=notes.units or {},
        source=source,
        controlled_element=notes.controlled_element or "",
        origin=origin,
        extra={name: values for name, values in signals.items() if name not in NAMES},
    )


def _require_shape(target: FloatArray, other: FloatArray, name: str, source: str) -> None:
    if target.shape[1] != other.shape[1] or len(target) not in (1, len(other)):
        raise InputError(
            f"{source}: signal ft has {len(target)} runs of {target.shape[1]} samples but {name} "
            f"has {len(other)} of {other.shape[1]}; all must be equal"
        )


def _interval(contents: Contents, samples: int, source: str, dt: float | None) -> TimeBase:
    """Sampling interval and run-in, from the file's times or from what is said in their place."""
    notes = contents.notes
    if contents.t is None:
        given = notes.dt if dt is None else dt
        if given is None:  # a reader would have refused the file
            raise InputError(f"{source}: the sampling interval is unknown; give it with --dt")
        if dt is not None and notes.dt is not None and abs(notes.dt - dt) > SNAP * dt:
            raise InputError(
                f"{notes.where}: says dt = {notes.dt:g} s but --dt says {dt:g} s; correct one of "
                "them"
            )
        return TimeBase(given, 0)
    base = time_base(contents.t, source, contents.where)
    reach = max(SNAP, 2 * UNEVENNESS / (contents.t.size - 1))
    if dt is not None and abs(dt - base.dt) > dt * reach:
        raise InputError(
            f"{source}: the time steps by {base.dt:g} s but --dt says {dt:g} s; leave --dt out, "
            "or the time"
        )
    if notes.dt is None:
        return base
    if abs(notes.dt - base.dt) > base.dt * reach:
        raise InputError(
            f"{notes.where}: says dt = {notes.dt:g} s but the time in {source} steps by "
            f"{base.dt:g} s; correct one of them"
        )
    return TimeBase(notes.dt, base.run_in)


def _agreed_run_in(negative: int, notes: Notes, dt: float, source: str) -> int:
    """Samples of run-in: those at negative times, or what the notes say if there are none."""
    if notes.run_in is None:
        return negative
    samples = round(notes.run_in / dt)
    if negative not in (0, samples):
        raise InputError(
            f"{notes.where}: says run_in = {notes.run_in:g} s but {negative * dt:g} s of {source} "
            "lie before t = 0; correct one of them"
        )
    return samples


def common_run(signal: FloatArray) -> FloatArray:
    """A forcing function to write: its first run alone if all runs are equal to the bit."""
    first = signal[:1]
    return first if all(run.tobytes() == first.tobytes() for run in signal) else signal


def refuse_codes(values: FloatArray, name: str, source: str) -> None:
    """Refuse a signal in which a number stands for missing values.

    Parameters
    ----------
    values
        A signal, shape (runs, samples).
    name, source
        What it is, for messages.

    Raises
    ------
    InputError
        If its largest magnitude is such a code, far from all else in the signal.
    """
    largest = max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))
    if largest < HUGE and not np.isclose(CODES, largest, rtol=1e-6, atol=0.0).any():
        return
    size = np.abs(values)
    there = size == largest
    if APART * float(size[~there].max(initial=0.0)) >= largest or there.all():
        return
    run, sample = (int(i) for i in np.argwhere(there)[0])
    count = int(np.count_nonzero(there))
    raise InputError(
        f"{source}: signal {name} is {values[run, sample]:g} at {count} "
        f"sample{'s' if count > 1 else ''}, the first of them sample {sample + 1} of run "
        f"{run + 1}: a code for missing values; repair or cut the recording there"
    )
