"""The recording in what a file holds: which names are those of signals, their runs and times."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pilotid.recording.contents import Variable, number_of, shown
from pilotid.recording.recording import ABSENT, SIGNALS, Recording, times
from pilotid.support.types import FloatArray, InputError

if TYPE_CHECKING:
    from pilotid.recording.sidecar import Sidecar

NAMES = {"t": "time", **SIGNALS}
SNAP = 1e-4  # relative: a rate this close to a whole number of hertz is that number
UNEVENNESS = 0.1  # of a sampling interval: time stamps rounded to milliseconds pass at 100 Hz
SECONDS = ("", "-", "s", "sec", "secs", "second", "seconds")  # units of time that are this one

#: A factor and a name in the file by signal.
Places = Mapping[str, tuple[float, str]]


class Content(NamedTuple):
    """What a file holds.

    Attributes
    ----------
    source
        The file's name, for messages.
    part
        The struct or group whose names are meant, or runs, as in ``sigma=17``; empty for any.
    notes
        What is said beside the file.
    variables
        The signals, and whatever else there is.
    """

    source: str
    part: str
    notes: Sidecar
    variables: Sequence[Variable]

    def columns(self, wanted: str, part: str, is_chosen: bool) -> list[Variable]:
        """The columns that a name may mean, in the order of runs.

        They are those of that name, or else in other case; within a struct or group before those
        outside.  A name that was chosen is that of one column, if there is one.
        """
        if is_chosen and (exact := [v for v in self.variables if v.name == wanted]):
            return exact
        for form in (str, str.casefold):
            for start in (f"{part}." * bool(part), ""):
                named = [v for v in self.variables if form(v.family) == form(start + wanted)]
                if named:
                    return sorted(named, key=lambda variable: variable.run)
        return []


def listed(names: Iterable[object]) -> str:
    """Names in a file, for a message."""
    texts = [shown(name)[1:-1] for name in names]
    return ", ".join(texts[:20] + ["..."] * (len(texts) > 20)) or "none"


def recording_of(content: Content, places: Places, dt: float | None) -> Recording:
    """The recording in a file.

    Parameters
    ----------
    content
        What the file holds.
    places
        The file's names of signals where they are not our own.
    dt
        The sampling interval [s] that the user gives, if any.

    Raises
    ------
    InputError
        If a signal is lacking or may be any of several, or if runs or arrays are unlike.
    """
    notes, source = content.notes, content.source
    stated = [interval for interval in (notes.dt, dt) if interval is not None]
    signals, origin, units = _signals(content, places, timed=bool(stated))
    if "=" in content.part:
        signals = _runs_at(content, signals)
    interval, negative = _time_base(signals.pop("t", None), stated, source)
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
    usual: dict[str, Any] = {name: signals.pop(name) for name in SIGNALS if name in signals}
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
    content: Content, places: Places, *, timed: bool
) -> tuple[dict[str, FloatArray], dict[str, str], dict[str, str]]:
    """Signals and the time [s] by name, shape (runs, samples), their origins and units."""
    signals, origin, units = {}, {}, dict[str, str]()
    samples = 0
    columns = _columns_of_signals(content, places, timed=timed)
    for signal in sorted(columns, key=lambda name: name != "u"):
        first, (factor, name) = columns[signal][0], places.get(signal, (1.0, signal))
        signals[signal] = factor * _rows(columns[signal], samples, content.source)
        samples = signals["u"].shape[1]
        of_runs = first.run > 0 and name != first.name
        origin[signal] = times(factor, first.family if of_runs else first.name)
        units |= {signal: first.unit} if first.unit else {}
    unit = units.pop("t", "")
    if unit.casefold() not in SECONDS and places.get("t", (1.0, ""))[0] == 1.0:
        raise InputError(
            f"{content.source}: the time is in {shown(unit)}; give it in s, of ms with "
            "--map t=0.001*NAME"
        )
    return signals, origin, units


def _rows(columns: Sequence[Variable], samples: int, source: str) -> FloatArray:
    """The samples of a signal, shape (runs, samples); of any number of samples if that is 0."""
    runs = list[FloatArray]()
    for name, run in ((column.name, run) for column in columns for run in column.numbers()):
        samples = samples or max(run.shape)  # recordings have more samples than runs
        table = run[:, np.newaxis] if run.ndim == 1 else run
        if table.ndim > 2 or samples not in table.shape:
            raise InputError(
                f"{source}: {name}, run {len(runs) + 1}, is {' x '.join(map(str, run.shape))} but "
                f"the first run of u has {samples} samples; give all signals at one rate, runs at "
                "one length, one column each"
            )
        runs.append(table.T if len(table) == samples else table)
    return np.concatenate(runs)


def _runs_at(content: Content, signals: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """The runs at which a variable with one number a run has the value in ``sigma=17``."""
    name, _, value = content.part.partition("=")
    levels = np.ravel([v.numbers() for v in content.variables if v.name == name])
    runs = len(signals["u"])
    chosen = levels == number_of(value)
    if chosen.size != runs or not chosen.any():
        raise InputError(
            f"{content.source}: no run has {shown(content.part)}, {name} is "
            f"{listed(np.unique(levels))}; choose by one number for each of the {runs} runs"
        )
    return {s: v[chosen] if len(v) == runs else v for s, v in signals.items()}


def _columns_of_signals(
    content: Content, places: Places, *, timed: bool
) -> dict[str, list[Variable]]:
    """The columns of each signal; `timed` says that the sampling interval is known without times.

    Of a file without u outside structs and groups they are those in the only one that has it.
    """
    source, part = content.source, "" if "=" in content.part else content.part
    names = [variable.name for variable in content.variables]
    families = {variable.family.casefold() for variable in content.variables}
    parts = dict.fromkeys(v.family.partition(".")[0] for v in content.variables if "." in v.family)
    if part and part not in parts:
        raise InputError(
            f"{source}: has no part {shown(part)}, only {listed(parts)}; name one behind ::"
        )
    wanted = {name: name for name in (*NAMES, *content.notes.extra)}
    wanted |= {signal: name for signal, (_, name) in places.items()}
    u = wanted["u"].casefold()
    within = {p: f"{p}.".casefold() for p in parts}
    holding = [p for p in parts if within[p] + u in families or u.startswith(within[p])]
    if not part and len(holding) == 1 and ("." in u or u not in families):
        part = holding[0]
    chosen = {*places, *content.notes.extra}
    every = {s: content.columns(name, part, s in chosen) for s, name in wanted.items()}
    columns = {signal: named for signal, named in every.items() if named}
    # Time may follow from a sampling interval; e and x from one another and the target.
    needed = chosen | {"u"} | (set() if timed else {"t"})
    needed |= set() if {"ft", "x"} <= columns.keys() else {"e"}
    if absent := [signal for signal in wanted if signal in needed - columns.keys()]:
        what = (f"{shown(wanted[s])} for {s} ({NAMES.get(s, 'extra signal')})" for s in absent)
        picks = ",".join(f"{s}=NAME" for s in absent)
        raise InputError(
            f"{source}: has no {', '.join(what)}, only {listed(names)}; name the right one with "
            f"--map {picks}, a factor as in u=-0.5*NAME{' or give --dt 0.01' * ('t' in absent)}"
            f"{f' or read a part, as in {source}::{holding[0]}' if holding else ''}"
        )
    for signal, several in columns.items():
        if len(several) > 1 and [c.run for c in several] != [*range(1, len(several) + 1)]:
            raise InputError(
                f"{source}: {listed(v.name for v in several)} may be {signal}; pick one, as in "
                f"--map {signal}={several[0].name}, or number runs from 1 without a gap"
            )
    return columns


def _time_base(times: FloatArray | None, stated: Sequence[float], source: str) -> tuple[float, int]:
    """Sampling interval [s] and number of samples before t = 0.

    They follow from the file's times (runs, samples), which must increase evenly, and from what is
    stated, which must agree with them and is the more exact.
    """
    intervals, negative, reach = list(stated), 0, SNAP
    if times is not None:
        dt, negative = _sampling(times, source)
        reach = max(SNAP, 2 * UNEVENNESS / (times.shape[1] - 1))
        intervals.append(dt)
    for interval in stated:
        if abs(interval - intervals[-1]) > reach * intervals[-1]:
            raise InputError(
                f"{source}: --dt or the note dt says {interval:g} s but the samples are "
                f"{intervals[-1]:g} s apart; leave one of the two out"
            )
    return intervals[0], negative


def _sampling(times: FloatArray, source: str) -> tuple[float, int]:
    """Interval [s] of even times (runs, samples), and number of those before 0."""
    if times.shape[1] < 2:
        raise InputError(f"{source}: holds {times.shape[1]} samples; at least 10 s are needed")
    t = times[0].astype(float)
    dt = float(t[-1] - t[0]) / (t.size - 1)
    off = np.abs([t - np.linspace(t[0], t[-1], t.size), *(times[1:] - t)])
    even = (off <= UNEVENNESS * dt).all(axis=1)
    if not (even.all() and 0.0 < dt < np.inf):
        run = int(np.argmin(even))
        steps = np.diff(times[run])
        worst = int(np.argmax(np.abs(steps - np.median(steps))))
        raise InputError(
            f"{source}: times must increase evenly and alike in all runs, but run {run + 1}, from "
            f"{times[run, 0]:.6g} s on, has a step of {steps[worst]:.6g} s behind "
            f"{times[run, worst]:.6g} s; begin all runs at one time, number runs, remove repeated "
            "rows, or resample"
        )
    rate = float(np.rint(1.0 / np.float64(dt)))
    dt = 1.0 / rate if abs(dt * rate - 1.0) <= SNAP else dt
    return dt, int(np.count_nonzero(t < -UNEVENNESS * dt))
