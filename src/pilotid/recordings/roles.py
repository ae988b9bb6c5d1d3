"""Which of the names in a file are those of signals, and the runs that their arrays hold."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pilotid.recordings.recording import SIGNALS, factor_of, is_unit, require_extra_name
from pilotid.support.types import FloatArray, InputError

if TYPE_CHECKING:
    from pilotid.recordings.sidecar import Sidecar

NAMES = {"t": "time", **SIGNALS}
UNEVENNESS = 0.1  # of a sampling interval: time stamps rounded to milliseconds pass at 100 Hz
#: Seconds in a unit of time.
TIMES = {
    **dict.fromkeys(("", "-", "s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "microseconds"), 1e-6),
}
MOST_VALUES = 2**25  # of all signals; ten minutes at 1 kHz in ten runs are 31 million
UNIT = re.compile(r"(.*\S)\s*(?:\[([^\[\]]*)\]|\(([^()]*[^()0-9][^()]*|1)\))", re.DOTALL)


class Place(NamedTuple):
    """Where a file keeps a signal: the name, a factor, and whether the user or a note named it."""

    name: str
    factor: float = 1.0
    chosen: bool = False

    def scaled(self, values: FloatArray) -> FloatArray:
        """Values in the unit and with the sign that the user gives them."""
        return values if self.factor == 1.0 else np.asarray(self.factor * values)


def signal_places(mapping: Mapping[str, str] | None, extra: Iterable[str] = ()) -> dict[str, Place]:
    """The place of every signal: the user's choice, or its own name.

    What is not one of `NAMES` is an extra signal.

    Raises
    ------
    InputError
        For what cannot be the name of a signal, or a choice that names nothing.
    """
    places = {signal: Place(signal) for signal in NAMES}
    places |= {name: Place(name, chosen=True) for name in extra}
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


def shown(text: object) -> str:
    """A text from a file, quoted for a message: one line, not too long."""
    words = " ".join(str(text).split())
    return repr(words if len(words) <= 40 else f"{words[:40]}...")


def listed(names: Iterable[object]) -> str:
    """Names found in a file, for a message."""
    texts = [shown(name)[1:-1] for name in names]
    return ", ".join(texts[:20] + ["..."] * (len(texts) > 20)) or "none"


def bare(name: str) -> tuple[str, str]:
    """A name without its unit, and the unit: ``t [s]`` and ``u (deg)`` have one."""
    match = UNIT.fullmatch(name)
    unit = (match[2] or match[3] or "").strip() if match else ""
    return (match[1], unit) if match and is_unit(unit) else (name, "")


def matching(wanted: str, names: Iterable[str]) -> list[str]:
    """The names that may be meant by one: itself, else with a unit, else in other case."""
    known = [(name, bare(name)[0]) for name in names]
    return (
        [name for name, _ in known if name == wanted]
        or [name for name, own in known if own == wanted]
        or [name for name, own in known if own.casefold() == wanted.casefold()]
    )


def only(wanted: str, names: Sequence[str], where: str, kind: str) -> str:
    """The one name by which runs or rows are chosen."""
    if len(found := matching(wanted, names)) != 1:
        raise InputError(
            f"{where}: has no {kind} {shown(wanted)}, only {listed(names)}; choose by one of them"
        )
    return found[0]


def is_level(value: object, wanted: str) -> bool:
    """Whether a value in a file is the one in a text; numbers are compared as such."""
    try:
        return float(str(value)) == float(wanted)
    except ValueError:
        return str(value).strip() == wanted


def require_level(source: str, name: str, wanted: str, there: Iterable[object]) -> None:
    """Refuse a value by which runs are chosen and that no run has."""
    values = {f"{v:.12g}" if isinstance(v, float) else str(v).strip(): v for v in there}
    if not any(is_level(value, wanted) for value in values.values()):
        raise InputError(
            f"{source}: no run has {shown(name)} = {shown(wanted)}; there are {listed(values)}"
        )


def _absent(places: Mapping[str, Place], found: Mapping[str, object], *, timed: bool) -> list[str]:
    """The signals that a file lacks and must have.

    Time may follow from a sampling interval (`timed`); e and x follow from one another and the
    target, and x is needed by channels of motion alone.
    """
    needed = {s for s, place in places.items() if place.chosen} | {"u"}
    needed |= set() if timed else {"t"}
    needed |= set() if {"ft", "x"} <= found.keys() else {"e"}
    lacking = [s for s in places if s in needed - found.keys()]
    # With others missing, a user who must name them should hear of this one as well.
    tells = bool(lacking) and not {*found, *lacking} & {"x", "ft"}
    return lacking + ["x"] * tells


def resolved(
    places: Mapping[str, Place], names: Sequence[str], where: str, kind: str, *, timed: bool
) -> dict[str, str]:
    """The name of each signal that a file has.

    Parameters
    ----------
    places
        Where signals are looked for.
    names
        Those in the file; ``data.u`` is u inside the struct data.
    where, kind
        Where the names stand, and what they stand for, in messages.
    timed
        Whether the sampling interval is known.

    Raises
    ------
    InputError
        If a signal is lacking that must be there, or may be any of several.
    """
    lacking = partial(_absent, places, timed=timed)
    found = {s: own for s, place in places.items() if (own := matching(place.name, names))}
    if kind == "variable" and (lacking(found) or "x" not in found):
        found |= _inside(places, found, names, where, lacking)
    if absent := lacking(found):
        what = ", ".join(
            f"{shown(places[s].name)} for {s} ({NAMES.get(s, 'extra signal')})" for s in absent
        )
        picks = ",".join(f"{s}={kind.upper()}" for s in absent)
        advice = ", or for want of t give --dt 0.01, say" * ("t" in absent)
        raise InputError(
            f"{where}: has no {kind} {what}, only {listed(names)}; name the right one with --map "
            f"{picks}{advice}"
        )
    for signal, own in found.items():
        if len(own) > 1:
            raise InputError(
                f"{where}: has {listed(own)}, any of which may be {signal}; pick one, as in --map "
                f"{signal}={own[0]}"
            )
    return {signal: own[0] for signal, own in found.items()}


def _inside(
    places: Mapping[str, Place],
    found: Mapping[str, list[str]],
    names: Sequence[str],
    where: str,
    lacking: Callable[[Mapping[str, object]], list[str]],
) -> dict[str, list[str]]:
    """The names of further signals in the one struct that holds all that is needed."""
    structs: dict[str, dict[str, list[str]]] = {}
    for name in names:
        root, *path = name.split(".")
        for start in range(len(path)):
            structs.setdefault(root, {}).setdefault(".".join(path[start:]), []).append(name)
    inside = {
        root: {
            signal: [name for key in keys for name in ends[key]]
            for signal, place in places.items()
            if signal not in found and (keys := matching(place.name, ends))
        }
        for root, ends in structs.items()
    }
    holding = [root for root in inside if inside[root] and not lacking({**found, **inside[root]})]
    holding = [root for root in holding if "x" in inside[root]] or holding
    if len(holding) > 1:
        raise InputError(
            f"{where}: the structs {listed(holding)} all hold {listed(inside[holding[0]])}; pick "
            f"one, as in {where}::{holding[0]}"
        )
    return inside[holding[0]] if holding else {}


class Request(NamedTuple):
    """What is wanted of a file.

    Attributes
    ----------
    mapping
        The file's names of signals; None for our own.
    part
        Name of the struct, group or cell that holds the recording; empty for all.
    levels
        Values of variables or columns by whose values runs are chosen.
    timed
        Whether the sampling interval is known, so that no times are needed.
    """

    mapping: Mapping[str, str] | None
    part: str
    levels: Mapping[str, str]
    timed: bool


#: The arrays of a signal by what they are called in messages: one, or one a run.
Pieces = Mapping[str, FloatArray]


class Found(NamedTuple):
    """What was found of it.

    Attributes
    ----------
    pieces, names, units, places
        By signal its arrays, its names in the file, its unit if one is said, and where it was
        looked for.
    notes
        What the file says beside the signals.
    where
        Puts the place of a sample of the time, by its index, into words.
    levels
        Values by run of variables by which runs are chosen.
    """

    pieces: Mapping[str, Pieces]
    names: Mapping[str, Iterable[str]]
    units: Mapping[str, str]
    places: Mapping[str, Place]
    notes: Sidecar
    where: Callable[[int], str]
    levels: Mapping[str, list[object]] = {}


def as_runs(found: Found, source: str) -> tuple[FloatArray | None, dict[str, FloatArray]]:
    """The time [s], shape (samples,), if there is one, and signals with one row a run.

    The number of samples tells rows from columns; where both fit, a column is a run.

    Raises
    ------
    InputError
        If arrays differ in length, or runs in their times.
    """
    unit = found.units.get("t", "").casefold()
    if unit not in TIMES:
        raise InputError(
            f"{source}: the unit of the time is {shown(unit)}; give the time in s, ms or us"
        )
    time = _common_time(found.pieces["t"], source) if "t" in found.pieces else None
    # Recordings have more samples than runs.
    samples = max(next(iter(found.pieces["u"].values())).shape) if time is None else time.size
    signals: dict[str, FloatArray] = {}
    for signal in [signal for signal in found.pieces if signal != "t"]:
        rows = []
        for name, array in found.pieces[signal].items():
            table = array[:, np.newaxis] if array.ndim == 1 else array
            if table.ndim > 2 or samples not in table.shape:
                raise InputError(
                    f"{source}: {name} is {' x '.join(map(str, array.shape))} but the time, or the "
                    f"first run, has {samples} samples; give all signals at one rate and all runs "
                    "at one length, one column a run"
                )
            rows.append(table.T if len(table) == samples else table)
        signals[signal] = found.places[signal].scaled(np.concatenate(rows))
    if sum(values.size for values in signals.values()) > MOST_VALUES:
        raise InputError(
            f"{source}: holds more than {MOST_VALUES} values, too many for a recording; thin it "
            "out in time or leave runs out"
        )
    return None if time is None else found.places["t"].scaled(time) * TIMES[unit], signals


def _common_time(times: Pieces, source: str) -> FloatArray:
    """The time that all runs have in common."""
    rows = []
    for name, array in times.items():
        table = array if array.ndim > 1 and len(array) < array.shape[1] else array.T
        rows += [(name, t.astype(float).ravel()) for t in (table if table.ndim > 1 else [table])]
    name, first = rows[0]
    for other, time in rows[1:]:
        if time.size != first.size or not (
            np.abs(time - first).max() <= UNEVENNESS * abs(first[-1] - first[0]) / time.size
        ):
            raise InputError(
                f"{source}: the time of {other} ({time.size} samples) differs from that of {name} "
                f"({first.size}); cut all runs to the same length, and give them the same times"
            )
    return first
