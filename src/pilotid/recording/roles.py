"""The recording in what a file holds: which names are those of signals, their runs and times."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
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


class Content(NamedTuple):
    """What a file holds.

    Attributes
    ----------
    kind, source
        What names are names of, column or variable, and the file's name, for messages.
    families
        The names that may be signals, and what each has in common with those of other runs: ``u``
        of ``u_1``.
    notes
        What the file says beside the signals.
    numbers
        Makes arrays of the column or variable of a name: one, or one a run.
    part
        The struct or group whose names are meant, or runs, as in ``sigma=17``; empty for any.
    units
        Units by column, where they stand in a row of their own.
    """

    kind: str
    source: str
    families: Mapping[str, str]
    notes: Sidecar
    numbers: Callable[[str], list[FloatArray]]
    part: str
    units: Mapping[str, str] = {}


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
                f"the mapping {signal}={choice} names nothing; write SIGNAL=NAME, SIGNAL=-3.5*NAME"
            )
    return places


def recording_of(
    content: Content, mapping: Mapping[str, str] | None, dt: float | None
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

    Raises
    ------
    InputError
        If a signal is lacking or may be any of several, or if runs or arrays are unlike.
    """
    notes, source = content.notes, content.source
    stated = [interval for interval in (dt, notes.dt) if interval is not None]
    signals, origin, units = _signals(content, mapping, timed=bool(stated))
    if "=" in content.part:
        signals = _runs_at(content, signals)
    interval, negative = _time_base(signals.pop("t", None), stated, source)
    interval = notes.dt or interval  # a note is the more exact
    for name, other in (("x", "e"), ("e", "x")):
        if name not in signals and len(signals.get("ft", ())) in (1, len(signals[other])):
            signals[name] = signals["ft"] - signals[other]
            origin[name] = f"ft - {other}"
    if "x" not in signals:
        signals["x"] = np.zeros_like(signals["u"])
        origin["x"] = ABSENT
    run_in = negative if notes.run_in is None else round(notes.run_in / interval)
    count = len(signals["u"])
    if notes.runs not in (None, count) or negative not in (0, run_in):
        raise InputError(
            f"{source}: holds {count} runs and {negative} samples of run-in but its notes say "
            f"{notes.runs or count} runs and {run_in} samples; correct one of them"
        )
    usual: dict[str, Any] = {name: signals.pop(name, None) for name in SIGNALS}
    return Recording(
        dt=interval,
        **usual,
        run_in=run_in,
        units={**units, **notes.units},
        source=source,
        origin=origin,
        extra=signals,
        **notes.model_dump(include={"lines", "controlled_element"}),
    )


def _signals(
    content: Content, mapping: Mapping[str, str] | None, *, timed: bool
) -> tuple[dict[str, FloatArray], dict[str, str], dict[str, str]]:
    """Signals and the time [s] by name, shape (runs, samples), their origins and units."""
    places = places_of(mapping, content.notes.extra)
    chosen = {*(mapping or {}), *content.notes.extra}
    columns = _columns_of_signals(content, places, chosen, timed=timed)
    values, origin, units = {}, {}, {}
    samples = 0
    for signal in sorted(columns, key=lambda name: name != "u"):
        names, (factor, name) = columns[signal], places[signal]
        units[signal] = bare(names[0])[1] or content.units.get(names[0], "")
        origin[signal] = times(factor, name if name in names else content.families[names[0]])
        runs = list[FloatArray]()
        for column, run in ((name, run) for name in names for run in content.numbers(name)):
            samples = samples or max(run.shape)  # recordings have more samples than runs
            table = run[:, np.newaxis] if run.ndim == 1 else run
            if table.ndim > 2 or samples not in table.shape:
                raise InputError(
                    f"{content.source}: {column}, run {len(runs) + 1}, is "
                    f"{' x '.join(map(str, run.shape))} but the first run of u has {samples} "
                    "samples; give all signals at one rate, runs at one length, one column each"
                )
            runs.append(table.T if len(table) == samples else table)
        values[signal] = factor * np.concatenate(runs)
    unit = units.pop("t", "").casefold()
    if unit not in TIMES:
        raise InputError(f"{content.source}: the time is in {shown(unit)}; give it in s, ms or us")
    if "t" in values:
        values["t"] = values["t"] * TIMES[unit]
    return values, origin, {name: unit for name, unit in units.items() if unit}


def _runs_at(content: Content, signals: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """The runs at which a variable with one number a run has the value in ``sigma=17``."""
    name, _, value = content.part.partition("=")
    levels = np.ravel(content.numbers(name) if name in content.families else ())
    runs = len(signals["u"])
    chosen = levels == number_of(value)
    if chosen.size != runs or not chosen.any():
        raise InputError(
            f"{content.source}: no run has {shown(content.part)}, {name} is "
            f"{listed(np.unique(levels))}; choose by one number for each of the {runs} runs"
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
        needed = chosen | {"u"} | (set() if timed else {"t"})
        needed |= set() if {"ft", "x"} <= columns.keys() else {"e"}
        return [signal for signal in places if signal in needed - columns.keys()]

    source, part = content.source, "" if "=" in content.part else content.part
    parts = dict.fromkeys(n.partition(".")[0] for n in content.families.values() if "." in n)
    if part and part not in parts:
        raise InputError(
            f"{source}: has no part {shown(part)}, only {listed(parts)}; name one behind ::"
        )
    columns = columns_in(part)
    is_found = part or ("x" in columns and not lacking(columns))
    holding = [inner for inner in parts if not (is_found or lacking(columns_in(inner)))]
    if len(holding) == 1:
        columns = columns_in(holding[0])
    if absent := lacking(columns):
        what = (f"{shown(places[s][1])} for {s} ({NAMES.get(s, 'extra signal')})" for s in absent)
        picks = ",".join(f"{s}={content.kind.upper()}" for s in absent)
        raise InputError(
            f"{source}: has no {content.kind} {', '.join(what)}, only {listed(content.families)}; "
            f"name the right one with --map {picks}, a factor as in u=-0.5*NAME"
            f"{' or give --dt 0.01' * ('t' in absent)}"
            f"{f' or read a part, as in {source}::{holding[0]}' if holding else ''}"
        )
    for signal, names in columns.items():
        families = {content.families[name] for name in names}
        numbered = [f"{family}_{run}" for family in families for run in range(1, len(names) + 1)]
        is_numbered = content.kind == "variable" or [bare(name)[0] for name in names] == numbered
        if len(names) > 1 and not (len(families) == 1 and is_numbered):
            raise InputError(
                f"{source}: {listed(names)} may be {signal}; pick one, as in "
                f"--map {signal}={names[0]}, or number runs from 1 without a gap"
            )
    return columns


def _columns(content: Content, wanted: str, part: str, is_chosen: bool) -> list[str]:
    """The columns that a name may mean, in the order of runs.

    They are those of that very name, or else with a unit, or else in other case; within a struct
    or group before those outside.  A name that was chosen is that of one column, if there is one.
    """
    if is_chosen and wanted in content.families:
        return [wanted]
    for form in (str, lambda name: bare(name)[0], lambda name: bare(name)[0].casefold()):
        for start in (f"{part}." * bool(part), ""):
            names = [n for n, f in content.families.items() if form(f) == form(start + wanted)]
            if names:
                return sorted(names, key=lambda name: (len(bare(name)[0]), name))
    return []


def _time_base(times: FloatArray | None, stated: Sequence[float], source: str) -> tuple[float, int]:
    """Sampling interval [s] and number of samples before t = 0.

    They follow from the file's times (runs, samples), which must increase evenly, or from what is
    stated in their place, which must agree with them.
    """
    if times is None:
        dt, negative, reach = stated[0], 0, SNAP
    else:
        if times.shape[1] < 2:
            raise InputError(f"{source}: holds {times.shape[1]} samples; at least 10 s are needed")
        if np.all(times[1:, 0] > times[:-1, -1]):  # a clock that runs on from run to run
            times = times - times[:, :1] + times[0, 0]
        t = times[0].astype(float)
        dt = float(t[-1] - t[0]) / (t.size - 1)
        off = np.abs([t - np.linspace(t[0], t[-1], t.size), *(times[1:] - t)])
        even = (off <= UNEVENNESS * dt).all(axis=1)
        if not (even.all() and 0.0 < dt < np.inf):
            run = int(np.argmin(even))
            steps = np.diff(times[run])
            worst = int(np.argmax(np.abs(steps - np.median(steps))))
            raise InputError(
                f"{source}: times must increase evenly and alike in all runs, but run {run + 1}, "
                f"from {times[run, 0]:.6g} s on, has a step of {steps[worst]:.6g} s behind "
                f"{times[run, worst]:.6g} s; remove repeated rows, number runs, or resample"
            )
        rate = float(np.rint(1.0 / np.float64(dt)))
        dt = 1.0 / rate if abs(dt * rate - 1.0) <= SNAP else dt
        negative = int(np.count_nonzero(t < -UNEVENNESS * dt))
        reach = max(SNAP, 2 * UNEVENNESS / (t.size - 1))
    for interval in stated:
        if abs(interval - dt) > reach * dt:
            raise InputError(
                f"{source}: --dt or the note dt says {interval:g} s but the samples are {dt:g} s "
                "apart; leave one of the two out"
            )
    return dt, negative
