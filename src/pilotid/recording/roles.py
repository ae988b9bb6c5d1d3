"""The recording in what a file holds: which names are those of signals, their runs and times.

What is said of it beside the file, in F.json, is a `Sidecar`.
"""

from __future__ import annotations

import codecs
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, NoReturn, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from pilotid.recording.contents import Variable, listed, number_of
from pilotid.recording.recording import ABSENT, SIGNALS, Recording, times
from pilotid.recording.windows import sidecar_path
from pilotid.support.disk import path_shown, require_file
from pilotid.support.types import FloatArray, InputError

NAMES = {"t": "time", **SIGNALS}
SNAP = 1e-4  # relative: a rate this close to a whole number of hertz is that number
UNEVENNESS = 0.1  # of a sampling interval: time stamps rounded to milliseconds pass at 100 Hz

Count = Annotated[int, Field(ge=1, lt=10**15)]
#: What can label an axis: printable, no dollar sign.
LABEL = r"^[^$\p{C}\p{Zl}\p{Zp}]*$"


class Sidecar(BaseModel):
    """What is said of a recording beside its file; what is not said is None or empty.

    Attributes
    ----------
    runs, run_in, dt
        Number of runs, length of the run-in [s], sampling interval [s].
    units, lines, controlled_element
        As in `Recording`.
    extra
        Names of extra signals that the file holds by these names.
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    runs: Count | None = None
    run_in: Annotated[float, Field(ge=0, lt=1e9)] | None = None
    dt: Annotated[float, Field(ge=1e-6, le=100)] | None = None
    units: dict[str, Annotated[str, Field(max_length=40, pattern=LABEL)]] = {}
    lines: dict[Literal["ft", "fd"], list[Count]] = {}
    extra: list[str] = []
    controlled_element: Annotated[str, Field(max_length=200, pattern=LABEL)] = ""

    @model_validator(mode="after")
    def _units_of_signals(self) -> Self:
        if unknown := self.units.keys() - {*SIGNALS, *self.extra}:
            raise ValueError(f"units: {min(unknown)[:50]!r} is no signal, nor named under extra")
        return self


def parsed(raw: str | bytes, where: str) -> Sidecar:
    """The facts in JSON text.

    Parameters
    ----------
    raw
        The text.
    where
        Where it stands, for messages.

    Raises
    ------
    InputError
        For an unknown key or a value of the wrong kind; of broken JSON with the line.
    """
    try:
        return Sidecar.model_validate_json(raw)
    except ValidationError as error:
        wrong = error.errors()[0]
        place = ".".join(map(str, wrong["loc"])) or "all of it"
        what = wrong["msg"].removeprefix("Value error, ")
        raise InputError(
            f"{where}: {place[:50]}: {what}; correct it, leave it out or rename the file "
            f"(the keys are {', '.join(Sidecar.model_fields)})"
        ) from None


def read_sidecar(file: Path) -> Sidecar:
    """The facts beside a file; none where it has no sidecar.

    Raises
    ------
    InputError
        If the sidecar cannot be used.
    """
    path = sidecar_path(file)
    if not path.is_file():
        return Sidecar()
    require_file(path)
    return parsed(path.read_bytes().removeprefix(codecs.BOM_UTF8), path_shown(path))


class Content(NamedTuple):
    """What a file holds, and what is said of it.

    Attributes
    ----------
    source
        The file's name, for messages.
    variables
        The signals, and whatever else there is.
    part
        The struct or group whose names are meant, or runs, as in ``sigma=17``; empty for any.
    notes
        What is said beside the file.
    places
        A factor and a name in the file by signal, of signals whose names were chosen.
    stated
        Sampling intervals [s] that the notes and the user state, if any.
    """

    source: str
    variables: Sequence[Variable]
    part: str
    notes: Sidecar
    places: Mapping[str, tuple[float, str]]
    stated: Sequence[float]

    def refuse(self, why: str) -> NoReturn:
        """Say what is wrong with the file."""
        raise InputError(f"{self.source}: {why}")

    def columns(self, wanted: str, part: str, is_chosen: bool) -> list[Variable]:
        """The columns that a name may mean, in the order of runs.

        They are those of that name, or else in other case; within a struct or group before those
        outside.  A name that was chosen is that of one column, if there is one.
        """
        candidates = (
            [v for v in self.variables if is_chosen and v.name == wanted],
            *(
                [v for v in self.variables if form(v.family) == form(start + wanted)]
                for form in (str, str.casefold)
                for start in (f"{part}." * bool(part), "")
            ),
        )
        return sorted(next(filter(None, candidates), []), key=lambda variable: variable.run)


def recording_of(content: Content) -> Recording:
    """The recording in a file.

    Raises
    ------
    InputError
        If a signal is lacking or may be any of several, or if runs or arrays are unlike.
    """
    notes = content.notes
    signals, origin, units = _signals(content)
    if "=" in content.part:
        signals = _runs_at(content, signals)
    interval, negative = _time_base(signals.pop("t", None), content)
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
        content.refuse(
            f"holds {count} runs and {negative} samples of run-in but its notes say "
            f"{notes.runs or count} runs and {run_in} samples; correct one of them"
        )
    usual: dict[str, Any] = {name: signals.pop(name) for name in SIGNALS if name in signals}
    return Recording(
        dt=interval,
        **usual,
        run_in=run_in,
        units={**units, **notes.units},
        source=content.source,
        origin=origin,
        extra=signals,
        **notes.model_dump(include={"lines", "controlled_element"}),
    )


def _signals(content: Content) -> tuple[dict[str, FloatArray], dict[str, str], dict[str, str]]:
    """Signals and the time [s] by name, shape (runs, samples), their origins and units."""
    signals, origin, units = {}, {}, dict[str, str]()
    columns = _columns_of_signals(content)
    samples = max(columns["u"][0].numbers()[0].shape)  # recordings have more of them than runs
    for signal, several in columns.items():
        first, (factor, name) = several[0], content.places.get(signal, (1.0, signal))
        signals[signal] = factor * _rows(several, samples, content)
        of_runs = first.run > 0 and name != first.name
        origin[signal] = times(factor, first.family if of_runs else first.name)
        units |= {signal: first.unit} if first.unit else {}
    unit = units.pop("t", "s")
    in_seconds = unit.casefold() in ("-", "s", "sec", "secs", "second", "seconds")
    if not in_seconds and content.places.get("t", (1.0, ""))[0] == 1.0:
        content.refuse(f"the time is in {unit!r}; give it in s, of ms with --map t=0.001*NAME")
    return signals, origin, units


def _rows(columns: Sequence[Variable], samples: int, content: Content) -> FloatArray:
    """The samples of a signal, shape (runs, samples)."""
    runs = list[FloatArray]()
    for name, run in ((column.name, run) for column in columns for run in column.numbers()):
        table = run[:, np.newaxis] if run.ndim == 1 else run
        if table.ndim > 2 or samples not in table.shape:
            content.refuse(
                f"{name}, run {len(runs) + 1}, is {' x '.join(map(str, run.shape))} but the first "
                f"run of u has {samples} samples; give all signals at one rate, runs at one "
                "length, one column each"
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
        content.refuse(
            f"no run has {content.part!r:.50}, {name} is {listed(np.unique(levels))}; choose by "
            f"one number for each of the {runs} runs"
        )
    return {s: v[chosen] if len(v) == runs else v for s, v in signals.items()}


def _columns_of_signals(content: Content) -> dict[str, list[Variable]]:
    """The columns of each signal.

    Of a file without u outside structs and groups they are those in the only one that has it.
    """
    part = "" if "=" in content.part else content.part
    families = {variable.family.casefold(): variable.family for variable in content.variables}
    parts = dict.fromkeys(f.partition(".")[0] for f in families.values() if "." in f)
    if part and part not in parts:
        content.refuse(f"has no part {part!r:.50}, only {listed(parts)}; name one behind ::")
    wanted = {name: name for name in NAMES}
    wanted |= {signal: name for signal, (_, name) in content.places.items()}
    u, within = wanted["u"].casefold(), {p: f"{p}.".casefold() for p in parts}
    holding = [p for p in parts if within[p] + u in families or u.startswith(within[p])]
    if not part and len(holding) == 1 and ("." in u or u not in families):
        part = holding[0]
    every = {s: content.columns(name, part, s in content.places) for s, name in wanted.items()}
    columns = {signal: named for signal, named in every.items() if named}
    # Time may follow from a sampling interval; e and x from one another and the target.
    follows = {"t"} if content.stated else set()
    follows |= {"e"} if {"ft", "x"} <= columns.keys() else set()
    needed = {"t", "u", "e"} - follows | content.places.keys()
    if absent := [signal for signal in wanted if signal in needed - columns.keys()]:
        what = (f"{wanted[s]!r:.50} for {s} ({NAMES.get(s, 'extra signal')})" for s in absent)
        picks = ",".join(f"{s}=NAME" for s in absent)
        content.refuse(
            f"has no {', '.join(what)}, only {listed(v.name for v in content.variables)}; name the "
            f"right one with --map {picks}, a factor as in u=-0.5*NAME"
            f"{' or give --dt 0.01' * ('t' in absent)}"
            f"{f' or read a part, as in {content.source}::{holding[0]}' if holding else ''}"
        )
    for signal, several in columns.items():
        if len(several) > 1 and [c.run for c in several] != [*range(1, len(several) + 1)]:
            content.refuse(
                f"{listed(v.name for v in several)} may be {signal}; pick one, as in "
                f"--map {signal}={several[0].name}, or number runs from 1 without a gap"
            )
    return columns


def _time_base(times: FloatArray | None, content: Content) -> tuple[float, int]:
    """Sampling interval [s] and number of samples before t = 0.

    They follow from the file's times (runs, samples), which must increase evenly, and from what is
    stated, which must agree with them and is the more exact.
    """
    stated = content.stated
    dt, negative, reach = (stated[-1], 0, SNAP) if times is None else _sampling(times, content)
    for interval in stated:
        if abs(interval - dt) > reach * dt:
            content.refuse(
                f"--dt or the note dt says {interval:g} s but the samples are {dt:g} s apart; "
                "leave one of the two out"
            )
    return stated[0] if stated else dt, negative


def _sampling(times: FloatArray, content: Content) -> tuple[float, int, float]:
    """Of even times (runs, samples) the interval [s], the number before 0, the relative error."""
    if times.shape[1] < 2:
        content.refuse(f"holds {times.shape[1]} samples; at least 10 s are needed")
    t = times[0].astype(float)
    dt = float(t[-1] - t[0]) / (t.size - 1)
    off = np.abs([t - np.linspace(t[0], t[-1], t.size), *(times[1:] - t)])
    even = (off <= UNEVENNESS * dt).all(axis=1)
    if not (even.all() and 0.0 < dt < np.inf):
        run = int(np.argmin(even))
        steps = np.diff(times[run])
        worst = int(np.argmax(np.abs(steps - np.median(steps))))
        content.refuse(
            f"times must increase evenly and alike in all runs, but run {run + 1}, from "
            f"{times[run, 0]:.6g} s on, has a step of {steps[worst]:.6g} s behind "
            f"{times[run, worst]:.6g} s; begin all runs at one time, number runs, remove repeated "
            "rows, or resample"
        )
    rate = float(np.rint(1.0 / np.float64(dt)))
    dt = 1.0 / rate if abs(dt * rate - 1.0) <= SNAP else dt
    error = max(SNAP, 2 * UNEVENNESS / (t.size - 1))
    return dt, int(np.count_nonzero(t < -UNEVENNESS * dt)), error
