"""The recording in what a file holds: which names are those of signals, their runs and times."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pilotid.recording.recording import (
    ABSENT,
    SIGNALS,
    Recording,
    factor_of,
    require_extra_name,
    times,
)
from pilotid.support.types import FloatArray, InputError

if TYPE_CHECKING:
    from pilotid.recording.sidecar import Sidecar

NAMES = {"t": "time", **SIGNALS}
SNAP = 1e-4  # relative: a rate this close to a whole number of hertz is that number
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


class MatlabObject(str):
    """The class of an object of MATLAB, whose content only MATLAB reads."""


class Content(NamedTuple):
    """What a file holds.

    Attributes
    ----------
    kind, where
        What names are names of, column or variable, and where they stand, for messages.
    columns
        What may be a signal, by name: cells of text, or an array.
    families
        The name that each has in common with those of other runs: ``u`` of ``u_1``.
    notes
        What the file says beside the signals.
    numbers
        Makes an array of the column or variable of a name.
    part
        The struct or group whose names are meant, or runs, as in ``sigma=17``; empty for any.
    units
        Units by column, where they stand in a row of their own.
    place
        Puts the place of a sample of the time, by its index, into words.
    runs
        Rows of each run of a table in long format, by words for it.
    """

    kind: str
    where: str
    columns: Mapping[str, Any]
    families: Mapping[str, str]
    notes: Sidecar
    numbers: Callable[[str], FloatArray]
    part: str = ""
    units: Mapping[str, str] = {}
    place: Callable[[int], str] = lambda sample: f"sample {sample + 1} of t"
    runs: Mapping[str, list[int]] = {}


def shown(text: object) -> str:
    """A text from a file, quoted for a message: one line, not too long."""
    words = " ".join(str(text).split())
    return repr(words if len(words) <= 40 else f"{words[:40]}...")


def listed(names: Iterable[object]) -> str:
    """Names in a file, for a message."""
    texts = [shown(name)[1:-1] for name in names]
    return ", ".join(texts[:20] + ["..."] * (len(texts) > 20)) or "none"


def is_unit(text: str) -> bool:
    """Whether a text can label an axis; a dollar sign would start a formula there."""
    return len(text) <= 40 and text.isprintable() and "$" not in text


def bare(name: str) -> tuple[str, str]:
    """A name without its unit, and the unit: ``t [s]`` and ``u (deg)`` have one."""
    match = UNIT.fullmatch(name)
    unit = (match[2] or match[3] or "").strip() if match else ""
    return (match[1], unit) if match and is_unit(unit) else (name, "")


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
                f"the mapping {signal}={choice} names nothing; write SIGNAL=NAME or "
                "SIGNAL=-3.5*NAME with the file's name for that signal"
            )
    return places


def recording_of(
    content: Content, mapping: Mapping[str, str] | None, dt: float | None, source: str
) -> Recording:
    """The recording in a file.

    Parameters
    ----------
    content
        What the file holds.
    mapping
        The file's names of signals; None for our own.
    dt
        The sampling interval [s] that the user gives, if any.
    source
        Its name in messages.

    Raises
    ------
    InputError
        If a signal is lacking or may be any of several, or if runs or arrays are unlike.
    """
    notes = content.notes
    intervals = {"--dt": dt, "the note dt": notes.dt}
    stated = {who: interval for who, interval in intervals.items() if interval is not None}
    signals, origin, units = _signals(content, mapping, timed=bool(stated))
    if "=" in content.part:
        signals = _runs_at(content, signals)
    interval, negative = _time_base(signals.pop("t", None), content.place, stated, source)
    for name, other in (("x", "e"), ("e", "x")):
        if name not in signals and len(signals.get("ft", ())) in (1, len(signals[other])):
            signals[name] = signals["ft"] - signals[other]
            origin[name] = f"ft - {other}"
    if "x" not in signals:
        signals["x"] = np.zeros_like(signals["u"])
        origin["x"] = ABSENT
    run_in = negative if notes.run_in is None else round(notes.run_in / interval)
    for what, noted, count in (
        ("runs", notes.runs, len(signals["u"])),
        ("samples of run-in", run_in, negative),
    ):
        if count and noted not in (None, count):
            raise InputError(
                f"{source}: its notes say {noted} {what} but it holds {count}; correct one of them"
            )
    usual: dict[str, Any] = {name: signals.pop(name, None) for name in SIGNALS}
    return Recording(
        dt=interval,
        **usual,
        run_in=run_in,
        lines={name: tuple(lines) for name, lines in notes.lines.items()},
        units={**units, **notes.units},
        source=source,
        controlled_element=notes.controlled_element,
        origin=origin,
        extra=signals,
    )


def _signals(
    content: Content, mapping: Mapping[str, str] | None, *, timed: bool
) -> tuple[dict[str, FloatArray], dict[str, str], dict[str, str]]:
    """Signals and the time [s] by name, shape (runs, samples), their origins and units."""
    places = places_of(mapping, content.notes.extra)
    chosen = {*(mapping or {}), *content.notes.extra}
    source = content.where.partition(": line")[0]
    columns = _columns_of_signals(content, places, chosen, timed=timed)
    values, origin, units = {}, {}, {}
    samples = 0
    for signal in sorted(columns, key=lambda name: name != "u"):
        names, (factor, name) = columns[signal], places[signal]
        units[signal] = bare(names[0])[1] or content.units.get(names[0], "")
        origin[signal] = times(factor, name if name in names else content.families[names[0]])
        arrays = {f"{content.kind} {n}": content.numbers(n) for n in names}
        if content.runs:
            (column,) = arrays.values()
            arrays = {words: column[rows] for words, rows in content.runs.items()}
        rows = []
        for words, array in arrays.items():
            samples = samples or max(array.shape)  # recordings have more samples than runs
            table = array[:, np.newaxis] if array.ndim == 1 else array
            if table.ndim > 2 or samples not in table.shape:
                raise InputError(
                    f"{source}: {words} is {' x '.join(map(str, array.shape))} but the first run "
                    f"of u has {samples} samples; give all signals at one rate and all runs at one "
                    "length, one column a run"
                )
            rows.append(table.T if len(table) == samples else table)
        values[signal] = factor * np.concatenate(rows)
    unit = units.pop("t", "").casefold()
    if unit not in TIMES:
        raise InputError(
            f"{source}: the unit of the time is {shown(unit)}; give the time in s, ms or us"
        )
    if "t" in values:
        values["t"] = values["t"] * TIMES[unit]
    return values, origin, {name: unit for name, unit in units.items() if unit}


def _runs_at(content: Content, signals: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """The runs at which a variable with one number a run has the value in ``sigma=17``."""
    name, _, value = content.part.partition("=")
    levels, runs = np.ravel(content.columns.get(name, "")), len(signals["u"])
    chosen = levels == number_of(value)
    if chosen.size != runs or not chosen.any():
        raise InputError(
            f"{content.where}: no run has {shown(name)} = {shown(value)}, but "
            f"{listed(dict.fromkeys(levels.tolist()))}; choose by a variable with one number for "
            f"each of the {runs} runs"
        )
    return {s: v[chosen] if len(v) == runs else v for s, v in signals.items()}


def number_of(text: str) -> float:
    """The number in a text, NaN if it holds none."""
    try:
        return float(text)
    except ValueError:
        return np.nan


def _columns_of_signals(
    content: Content, places: Places, chosen: set[str], *, timed: bool
) -> dict[str, list[str]]:
    """The columns of each signal, within the one struct or group that holds all of them."""

    def columns_in(part: str) -> dict[str, list[str]]:
        every = {s: _columns(content, n, part, s in chosen) for s, (_, n) in places.items()}
        return {signal: names for signal, names in every.items() if names}

    def lacking(columns: Mapping[str, object]) -> list[str]:
        # Time may follow from a sampling interval; e and x from one another and the target.
        needed = chosen | {"u"} | ({"t"} if not timed else set())
        needed |= set() if {"ft", "x"} <= columns.keys() else {"e"}
        absent = [signal for signal in places if signal in needed - columns.keys()]
        # With others missing, a user who must name them should hear of this one as well.
        return absent + ["x"] * (bool(absent) and not {*columns, *absent} & {"x", "ft"})

    part = "" if "=" in content.part else content.part
    columns = columns_in(part)
    if not part and (lacking(columns) or "x" not in columns):
        parts = dict.fromkeys(n.partition(".")[0] for n in content.families.values() if "." in n)
        inside = {part: columns_in(part) for part in parts}
        holding = {part: names for part, names in inside.items() if not lacking(names)}
        if len(holding) > 1 and lacking(columns):
            raise InputError(
                f"{content.where}: the structs {listed(holding)} all hold signals; pick one, as in "
                f"{content.where}::{next(iter(holding))}"
            )
        if len(holding) == 1:
            columns = next(iter(holding.values()))
    if absent := lacking(columns):
        what = ", ".join(
            f"{shown(places[s][1])} for {s} ({NAMES.get(s, 'extra signal')})" for s in absent
        )
        picks = ",".join(f"{s}={content.kind.upper()}" for s in absent)
        advice = ", or for want of t give --dt 0.01, say" * ("t" in absent)
        objects = {n: v for n, v in content.columns.items() if isinstance(v, MatlabObject)}
        for name, kind in objects.items():
            advice = f"; {name} is a MATLAB {kind}, of which only MATLAB makes matrices"
        raise InputError(
            f"{content.where}: has no {content.kind} {what}, only {listed(content.families)}; name "
            f"the right one with --map {picks}{advice}"
        )
    for signal, names in columns.items():
        families = {content.families[name] for name in names}
        numbered = [f"{family}_{run}" for family in families for run in range(1, len(names) + 1)]
        is_numbered = content.kind == "variable" or [bare(name)[0] for name in names] == numbered
        if len(names) > 1 and not (len(families) == 1 and is_numbered):
            raise InputError(
                f"{content.where}: has the {content.kind}s {listed(names)}, any of which may be "
                f"{signal}; pick one, as in --map {signal}={names[0]}, or number runs from 1 "
                "without a gap"
            )
    return columns


def _columns(content: Content, wanted: str, part: str, is_chosen: bool) -> list[str]:
    """The columns that a name may mean, in the order of runs.

    They are those of that very name, or else with a unit, or else in other case; within a struct
    or group before those outside.  A name that was chosen is that of one column, if there is one.
    """
    if is_chosen and wanted in content.columns:
        return [wanted]
    starts = ("", f"{part}.") if part else ("",)
    for form in (str, lambda name: bare(name)[0], lambda name: bare(name)[0].casefold()):
        for start in reversed(starts):
            names = [
                name
                for name, family in content.families.items()
                if family.startswith(start) and form(family.removeprefix(start)) == form(wanted)
            ]
            if names:
                return sorted(names, key=lambda name: (len(bare(name)[0]), bare(name)[0]))
    return []


def _time_base(
    times: FloatArray | None, where: Callable[[int], str], stated: Mapping[str, float], source: str
) -> tuple[float, int]:
    """Sampling interval [s] and number of samples before t = 0.

    They follow from the file's times (runs, samples), which must increase evenly, or from what is
    stated in their place, which must agree with them; a note is the more exact.
    """
    if times is None:
        dt, negative, reach = next(iter(stated.values())), 0, SNAP
    else:
        t = times[0].astype(float)
        if t.size < 2:
            raise InputError(f"{source}: holds {t.size} samples; at least 10 s are needed")
        steps, dt = np.diff(t), float(t[-1] - t[0]) / (t.size - 1)
        alike = np.abs(times - t).max(axis=1) <= UNEVENNESS * abs(dt)
        if len(times) > 1 and not alike.all():
            raise InputError(
                f"{source}: the time of run {1 + int(np.argmin(alike))} differs from that of the "
                "first; give all runs the same times"
            )
        off = np.abs(t - np.linspace(t[0], t[-1], t.size)).max()
        if not (off <= UNEVENNESS * dt and 0.0 < dt < np.inf):
            usual = float(np.median(steps))
            increasing = steps.min() > 0.0
            worst = int(np.argmax(np.abs(steps - usual)) if increasing else np.argmin(steps))
            raise InputError(
                f"{source}: the time steps by {steps[worst]:.6g} s at {where(worst + 1)} but by "
                f"{usual:.6g} s elsewhere; remove repeated rows, give repeated runs a column or a "
                "run number each, or resample to even steps"
            )
        rate = float(np.rint(1.0 / np.float64(dt)))
        dt = 1.0 / rate if abs(dt * rate - 1.0) <= SNAP else dt
        negative = int(np.count_nonzero(t < -UNEVENNESS * dt))
        reach = max(SNAP, 2 * UNEVENNESS / (t.size - 1))
    for who, interval in stated.items():
        if abs(interval - dt) > reach * dt:
            raise InputError(
                f"{source}: {who} says {interval:g} s but the samples are {dt:g} s apart; leave "
                "one of the two out"
            )
    return stated.get("the note dt", dt), negative
