"""Which of the names in a file are those of signals, and the runs that their arrays hold."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pilotid.recording.recording import SIGNALS, factor_of, is_unit, require_extra_name, times
from pilotid.support.types import FloatArray, InputError

if TYPE_CHECKING:
    from pilotid.recording.sidecar import Sidecar

NAMES = {"t": "time", **SIGNALS}
UNEVENNESS = 0.1  # of a sampling interval: time stamps rounded to milliseconds pass at 100 Hz
#: Seconds in a unit of time.
TIMES = {
    **dict.fromkeys(("", "-", "s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "microseconds"), 1e-6),
}
UNIT = re.compile(r"(.*\S)\s*(?:\[([^\[\]]*)\]|\(([^()]*[^()0-9][^()]*|1)\))", re.DOTALL)

#: A factor and a name in the file by signal.
Places = Mapping[str, tuple[float, str]]
#: Columns or variables by the name that they have in common: one, or one a run.
Families = Mapping[str, Mapping[str, Any]]


class Content(NamedTuple):
    """What a file holds.

    Attributes
    ----------
    families
        What may be a signal.
    parts
        The same within structs and groups, by their names.
    notes
        What the file says beside the signals.
    numbers
        Makes an array of a column or variable, given its name and value.
    where, kind
        Where the names stand, and what they are names of, for messages.
    units
        Units by column, where they stand in a row of their own.
    place
        Puts the place of a sample of the time, by its index, into words.
    runs
        Rows of each run of a table in long format, by words for it.
    advice
        What to do with a file whose signals nobody can read.
    """

    families: Families
    parts: Mapping[str, Families]
    notes: Sidecar
    numbers: Callable[[str, Any], FloatArray]
    where: str
    kind: str
    units: Mapping[str, str] = {}
    place: Callable[[int], str] = lambda sample: f"sample {sample + 1} of t"
    runs: Mapping[str, list[int]] = {}
    advice: str = ""


class Signals(NamedTuple):
    """The signals of a file: time [s], values by name, shape (runs, samples), origin and unit."""

    time: FloatArray | None
    values: dict[str, FloatArray]
    origin: dict[str, str]
    units: dict[str, str]


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


def places_of(mapping: Mapping[str, str] | None, extra: Iterable[str]) -> Places:
    """A factor and a name in the file by signal; what is not one of `NAMES` is an extra signal.

    Raises
    ------
    InputError
        For what cannot be the name of a signal, or a choice that names nothing.
    """
    places = {name: (1.0, name) for name in (*NAMES, *extra)}
    for signal, choice in (mapping or {}).items():
        if signal not in NAMES:
            require_extra_name(signal)
        factor, name = places[signal] = factor_of(choice)
        if not name or not (np.isfinite(factor) and factor):
            raise InputError(
                f"the mapping {signal}={choice} names nothing; write {signal}=NAME or "
                f"{signal}=-3.5*NAME with the file's name for that signal"
            )
    return places


def signals_of(content: Content, mapping: Mapping[str, str] | None, *, timed: bool) -> Signals:
    """The signals of a file.

    The number of samples tells rows from columns; where both fit, a column is a run.

    Parameters
    ----------
    content
        What the file holds.
    mapping
        The file's names of signals; None for our own.
    timed
        Whether the sampling interval is known, so that no times are needed.

    Raises
    ------
    InputError
        If a signal is lacking or may be any of several, or if runs or arrays are unlike.
    """
    places = places_of(mapping, content.notes.extra)
    chosen = {*(mapping or {}), *content.notes.extra}
    source = content.where.partition(": line")[0]
    families, names = _resolved(content, places, chosen, timed=timed)
    pieces: dict[str, dict[str, FloatArray]] = {}
    origin, units = {}, {}
    for signal, name in names.items():
        factor, members = places[signal][0], families[name]
        if content.kind == "column":
            members = _columns(members, signal, content.where, name if signal in chosen else "")
        arrays = {f"{content.kind} {n}": content.numbers(n, v) for n, v in members.items()}
        if content.runs:
            arrays = {
                words: values[rows]
                for values in arrays.values()
                for words, rows in content.runs.items()
            }
        pieces[signal] = arrays
        first = next(iter(members))
        units[signal] = bare(first)[1] or content.units.get(first, "")
        known = members if content.kind == "column" else dict.fromkeys(map(family_of, members))
        origin[signal] = ", ".join(times(factor, n) for n in known)
    unit = units.pop("t", "").casefold()
    if unit not in TIMES:
        raise InputError(
            f"{source}: the unit of the time is {shown(unit)}; give the time in s, ms or us"
        )
    time = _common_time(pieces.pop("t"), source) if "t" in pieces else None
    # Recordings have more samples than runs.
    samples = max(next(iter(pieces["u"].values())).shape) if time is None else time.size
    values = {}
    for signal, arrays in pieces.items():
        rows = []
        for name, array in arrays.items():
            table = array[:, np.newaxis] if array.ndim == 1 else array
            if table.ndim > 2 or samples not in table.shape:
                raise InputError(
                    f"{source}: {name} is {' x '.join(map(str, array.shape))} but the time, or the "
                    f"first run, has {samples} samples; give all signals at one rate and all runs "
                    "at one length, one column a run"
                )
            rows.append(table.T if len(table) == samples else table)
        factor = places[signal][0]
        joined = np.concatenate(rows)
        values[signal] = joined if factor == 1.0 else factor * joined
    if time is not None:
        time = (time if places["t"][0] == 1.0 else places["t"][0] * time) * TIMES[unit]
    return Signals(time, values, origin, {s: u for s, u in units.items() if u})


def _columns(members: Mapping[str, Any], signal: str, where: str, chosen: str) -> Mapping[str, Any]:
    """The columns of a signal: the one that was chosen, or all, which number runs from 1."""
    if chosen in members:
        return {chosen: members[chosen]}
    names = sorted(members, key=lambda name: (len(bare(name)[0]), bare(name)[0]))
    runs = [bare(name)[0].rpartition("_")[2] for name in names]
    if len(names) > 1 and runs != [str(n + 1) for n in range(len(names))]:
        raise InputError(
            f"{where}: has the columns {listed(names)}, any of which may be {signal}; pick one, as "
            f"in --map {signal}={names[0]}, or number runs from 1 without a gap"
        )
    return {name: members[name] for name in names}


def family_of(name: str) -> str:
    """The name that the members of an array have in common: ``data(2).u`` is of ``data.u``."""
    return re.sub(r"\([0-9]+\)|\{[0-9]+\}", "", name)


def _resolved(
    content: Content, places: Places, chosen: set[str], *, timed: bool
) -> tuple[Families, dict[str, str]]:
    """The families of a file, or of the one part that holds all signals, and each signal's name."""

    def found_in(families: Families) -> dict[str, list[str]]:
        every = {s: matching(name, families) for s, (_, name) in places.items()}
        return {signal: names for signal, names in every.items() if names}

    def lacking(found: Mapping[str, object]) -> list[str]:
        # Time may follow from a sampling interval; e and x from one another and the target.
        needed = chosen | {"u"} | ({"t"} if not timed else set())
        needed |= set() if {"ft", "x"} <= found.keys() else {"e"}
        absent = [signal for signal in places if signal in needed - found.keys()]
        # With others missing, a user who must name them should hear of this one as well.
        return absent + ["x"] * (bool(absent) and not {*found, *absent} & {"x", "ft"})

    families, found = content.families, found_in(content.families)
    if lacking(found) or "x" not in found:
        views = {part: found_in(view) for part, view in content.parts.items()}
        holding = {part: view for part, view in views.items() if not lacking(view)}
        holding = {p: v for p, v in holding.items() if "x" in v} or holding
        if len(holding) > 1 and lacking(found):
            raise InputError(
                f"{content.where}: the structs {listed(holding)} all hold signals; pick one, as in "
                f"{content.where}::{next(iter(holding))}"
            )
        if len(holding) == 1:
            ((part, found),) = holding.items()
            families = content.parts[part]
    if (absent := lacking(found)) and content.advice:
        raise InputError(f"{content.where}: {content.advice}")
    if absent:
        what = ", ".join(
            f"{shown(places[s][1])} for {s} ({NAMES.get(s, 'extra signal')})" for s in absent
        )
        picks = ",".join(f"{s}={content.kind.upper()}" for s in absent)
        advice = ", or for want of t give --dt 0.01, say" * ("t" in absent)
        raise InputError(
            f"{content.where}: has no {content.kind} {what}, only {listed(content.families)}; name "
            f"the right one with --map {picks}{advice}"
        )
    for signal, names in found.items():
        if len(names) > 1:
            raise InputError(
                f"{content.where}: has {listed(names)}, any of which may be {signal}; pick one, as "
                f"in --map {signal}={names[0]}"
            )
    return families, {signal: names[0] for signal, names in found.items()}


def _common_time(pieces: Mapping[str, FloatArray], source: str) -> FloatArray:
    """The time that all runs have in common."""
    rows = []
    for name, array in pieces.items():
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
