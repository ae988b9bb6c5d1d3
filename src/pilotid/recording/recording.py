"""The one data object that every method reads."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import wraps
from types import MappingProxyType
from typing import Any, Concatenate, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from pilotid.support.numbers import Range, in_range
from pilotid.support.types import SIGNAL_NAME, FloatArray, InputError, is_signal_name, printable

P = ParamSpec("P")
T = TypeVar("T")

#: Signals of a recording: name, and what it is.
SIGNALS = {
    "e": "tracking error",
    "u": "control",
    "x": "controlled output",
    "ft": "target forcing function",
    "fd": "disturbance forcing function",
}
SHORTEST = 10.0  # seconds of measurement window that an identification needs
COARSEST = 0.1  # seconds between samples: half that rate is just above the pilot's band
LARGEST = 1e100  # of a signal in any unit; squares and their sums must not overflow
LARGE_MEAN = 30.0
LEAST = 5.0  # s that must be left to score
DT, RUN_IN = Range(1e-6, 100.0), Range(0, 10**9, True)
LEAD, LINE = Range(0.0, 3600.0), Range(1, 10**7, True)
LONGEST_UNIT = 40  # characters
LONGEST_ELEMENT = 200


#: The origin of x where it was not recorded: it is zero, and no signal.
ABSENT = "not recorded"
LEAD_IN = 3.0  # seconds from which a prediction starts, where no run-in is longer


def is_unit(text: object) -> bool:
    """Whether a text can label an axis; a dollar sign would start a formula there."""
    return _is_text(text, LONGEST_UNIT) and "$" not in str(text)


def _is_text(text: object, longest: int) -> bool:
    return isinstance(text, str) and len(text) <= longest and text.isprintable()


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """One condition of one subject or simulation, in one or more runs.

    All signals are read-only arrays of shape (runs, samples) on one uniform
    time base; the first `run_in` samples lie before t = 0 and are pre-history:
    methods may use them to start from, and score only what follows.

    Attributes
    ----------
    dt
        Sampling interval [s].
    e, u, x
        Error, control and controlled output.  e = ft - x in a compensatory task.
    ft, fd
        Target and disturbance forcing functions, None where unknown.
    run_in
        Number of samples before the measurement window.
    lines
        Forcing-function lines per signal (``ft``, ``fd``), as multiples of
        2 pi / T with T the length of the measurement window; empty if unknown.
    units
        Unit by signal name.
    source
        Where the data came from, for messages and reports.
    controlled_element
        A description for reports, if known.
    origin
        Where signals came from: the file's names, what they follow from, or `ABSENT` for an x
        that was not recorded.
    treatment
        What was done to the signals since, a sentence each.
    lead_in
        Time before the first scored sample that methods in the time domain need [s]: they
        predict from it and do not score it.  A run-in counts towards it, so that all of the window
        is scored after a run-in as long as this.
    extra
        Other signals that a pilot may act on, by their names.
    """

    dt: float
    e: FloatArray
    u: FloatArray
    x: FloatArray
    ft: FloatArray | None = None
    fd: FloatArray | None = None
    run_in: int = 0
    lines: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    source: str = "recording"
    controlled_element: str = ""
    origin: Mapping[str, str] = field(default_factory=dict)
    treatment: tuple[str, ...] = ()
    lead_in: float = LEAD_IN
    extra: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._check_types()
        if self.dt > COARSEST:
            raise InputError(
                f"{self.source}: the sampling interval is {self.dt:.3g} s; a pilot's control needs "
                f"at most {COARSEST:g} s between samples; give the time in seconds"
            )
        for name in ("u", *SIGNALS):
            value = getattr(self, name)
            if value is not None or name in "eux":
                object.__setattr__(self, name, self._checked(name, value))
        extra = {name: self._checked(name, value) for name, value in self.extra.items()}
        object.__setattr__(self, "extra", MappingProxyType(extra))
        for name, unit in self.units.items():
            if not is_unit(unit):
                raise InputError(
                    f"{self.source}: the unit of {name} must be at most {LONGEST_UNIT} printable "
                    "characters without $; shorten it or leave it out"
                )
        if not _is_text(self.controlled_element, LONGEST_ELEMENT):
            raise InputError(
                f"{self.source}: the description of the controlled element must be at most "
                f"{LONGEST_ELEMENT} printable characters; shorten it or leave it out"
            )
        if not 0 <= self.run_in < self.u.shape[1]:
            raise InputError(
                f"{self.source}: the run-in ({self.run_in} samples) must be shorter than the "
                f"recording ({self.u.shape[1]} samples)"
            )
        if self.duration < SHORTEST:
            raise InputError(
                f"{self.source}: the measurement window lasts {self.duration:.3g} s; at least "
                f"{SHORTEST:g} s are needed (is each signal stored as one column a run?)"
            )
        scored = self.duration - max(0.0, self.lead_in - self.run_in * self.dt)
        if scored < LEAST:
            raise InputError(
                f"{self.source}: a lead-in of {self.lead_in:g} s leaves {scored:.3g} s to score; "
                f"at least {LEAST:g} s are needed"
            )
        still = np.ptp(self.u[:, self.run_in :], axis=1) == 0.0
        if still.any():
            raise InputError(
                f"{self.source}: the control u is constant in run {1 + int(np.argmax(still))}; "
                "map u to the recorded control, or leave that run out"
            )

    def _check_types(self) -> None:
        """Numbers in their ranges, and texts and mappings as Python's own."""
        source = printable(str(self.source))
        found: dict[str, object] = {"source": source, "treatment": tuple(self.treatment)}
        try:
            for name, known in (("dt", DT), ("run_in", RUN_IN), ("lead_in", LEAD)):
                found[name] = in_range(getattr(self, name), known, name)
            for name in self.extra:
                require_extra_name(name)
            lines = {k: [int(in_range(n, LINE, "lines")) for n in v] for k, v in self.lines.items()}
        except InputError as error:
            raise InputError(f"{source}: {error}") from None
        found["lines"] = MappingProxyType({k: tuple(v) for k, v in lines.items() if v})
        for name in ("units", "origin", "extra"):
            found[name] = MappingProxyType(dict(getattr(self, name)))
        for name, value in found.items():
            object.__setattr__(self, name, value)

    def __reduce__(self) -> tuple[object, ...]:
        values = (getattr(self, name) for name in self.__dataclass_fields__)
        return type(self), tuple(dict(v) if isinstance(v, Mapping) else v for v in values)

    def _checked(self, name: str, value: ArrayLike) -> FloatArray:
        try:
            given = np.asarray(value)
            real = given.dtype.kind in "fiuO" and not np.ma.is_masked(value)
            array = given.astype(float, order="C") if real else None
        except (TypeError, ValueError):
            array = None
        if array is None:
            raise InputError(
                f"{self.source}: signal {name} must be an array of real numbers, none of them "
                "masked; repair or cut the recording there"
            )
        shape = array.shape if name == "u" else self.u.shape
        if array.ndim != 2 or not len(array):
            raise InputError(f"{self.source}: signal {name} must have the shape (runs, samples)")
        if name not in ("e", "u", "x") and array.shape == (1, *shape[1:]):
            array = np.repeat(array, shape[0], axis=0)  # the same function in every run
        if array.shape != shape:
            raise InputError(
                f"{self.source}: signal {name} has {array.shape[0]} runs of {array.shape[1]} "
                f"samples but u has {shape[0]} of {shape[1]}; all must be equal"
            )
        bad = ~(np.abs(array) <= LARGEST)
        if bad.any():
            run, sample = (int(i) for i in np.argwhere(bad)[0])
            raise InputError(
                f"{self.source}: signal {name} is {array[run, sample]:g} at sample {sample + 1} of "
                f"run {run + 1}; repair or cut the recording there"
            )
        array.flags.writeable = False
        return array

    @property
    def runs(self) -> int:
        """Number of runs."""
        return int(self.u.shape[0])

    @property
    def samples(self) -> int:
        """Samples of the measurement window, without the run-in."""
        return int(self.u.shape[1]) - self.run_in

    @property
    def duration(self) -> float:
        """Length of the measurement window [s]."""
        return self.samples * self.dt

    @property
    def time(self) -> FloatArray:
        """Time [s], negative in the run-in, shape (run-in + samples,)."""
        return (np.arange(self.u.shape[1], dtype=float) - self.run_in) * self.dt

    def input(self, name: str) -> FloatArray:
        """A signal by its name, shape (runs, run-in + samples).

        A target that was not recorded is e + x.
        """
        return self.e + self.x if name == "ft" and self.ft is None else self.arrays[name]

    def window(self, signal: FloatArray) -> FloatArray:
        """The part of a signal inside the measurement window, shape (runs, samples)."""
        return signal[:, self.run_in :]

    @property
    def signals(self) -> list[str]:
        """Names of the signals that it has."""
        return [name for name in self.arrays if self.origin.get(name) != ABSENT]

    @property
    def arrays(self) -> dict[str, FloatArray]:
        """All signals by their names, each of shape (runs, run-in + samples)."""
        own = {name: getattr(self, name) for name in SIGNALS}
        return {name: own[name] for name in own if own[name] is not None} | {**self.extra}

    def with_arrays(self, arrays: Mapping[str, FloatArray], **changes: Any) -> Recording:
        """The same with other signals, and with other attributes.

        Parameters
        ----------
        arrays
            Signals by their names, shape (runs, run-in + samples); those that are not there stay.
        changes
            Attributes by their names.
        """
        own: dict[str, Any] = {name: arrays[name] for name in arrays if name in SIGNALS}
        extra = {name: arrays.get(name, signal) for name, signal in self.extra.items()}
        return replace(self, **own, **changes, extra=extra)

    def cut(self, start: float, end: float) -> Recording:
        """A span of the measurement window; all before it becomes run-in.

        Forcing lines stay where the span holds whole periods of all of a function's lines.

        Parameters
        ----------
        start, end
            The span [s].

        Raises
        ------
        InputError
            If it is no span, the window ends before it does, or it is too short.
        """
        if not 0.0 <= start < end < np.inf:
            raise InputError(f"the span {start:g}:{end:g} must be START:END in seconds, as in 0:41")
        first, last = round(start / self.dt), round(end / self.dt)
        if last > self.samples:
            raise InputError(
                f"the span {start:g}:{end:g}: the window of {self.source} ends at "
                f"{self.duration:.4g} s"
            )
        share = (last - first) / self.samples
        lines = {name: [line * share for line in own] for name, own in self.lines.items()}
        kept = {
            name: tuple(round(line) for line in own)
            for name, own in lines.items()
            if all(abs(line - round(line)) < 1e-6 for line in own)
        }
        whole = self.run_in + last
        return self.with_arrays(
            {name: signal[:, :whole] for name, signal in self.arrays.items()},
            lines=kept,
            run_in=self.run_in + first,
            source=f"{self.source}, {start:g} to {end:g} s",
        )

    def flipped(self, *names: str) -> str:
        """What --map takes to turn the signs of signals round."""
        return ",".join(self.scaled(name, -1.0) for name in names)

    def scaled(self, name: str, factor: float) -> str:
        """What --map takes to multiply a signal by a factor.

        Parameters
        ----------
        name
            The signal.
        factor
            What it is multiplied by.
        """
        own, place = factor_of(self.origin.get(name, name))
        return f"{name}={times(factor * own, place)}"

    @property
    def description(self) -> str:
        """One line: where it came from, how long and how fast."""
        runs = "1 run" if self.runs == 1 else f"{self.runs} runs"
        run_in = f" after {self.run_in * self.dt:.4g} s of run-in" if self.run_in else ""
        rate = f"{1.0 / self.dt:.4g} Hz"
        return f"{self.source}: {runs} of {self.duration:.4g} s at {rate}{run_in}"

    def __repr__(self) -> str:
        return f"<Recording {self.description}, signals {' '.join(self.signals)}>"

    def to_dict(self) -> dict[str, object]:
        """All but the samples as plain objects, as JSON has them."""
        return {
            "source": self.source,
            "runs": self.runs,
            "samples": self.samples,
            "dt": self.dt,
            "duration": self.duration,
            "run_in": self.run_in * self.dt,
            "signals": self.signals,
            "units": dict(self.units),
            "lines": {name: list(lines) for name, lines in self.lines.items()},
            "controlled_element": self.controlled_element,
        }


def require_extra_name(name: object) -> None:
    """Refuse what cannot name an extra signal.

    Raises
    ------
    InputError
        If it is not `SIGNAL_NAME`, or the name of something else in a recording.
    """
    if not is_signal_name(name) or str(name).casefold() in (*SIGNALS, "t", "run"):
        raise InputError(
            f"an extra signal cannot be named {name!r:.50}; name it otherwise than "
            f"{', '.join(SIGNALS)}, t and run, by {SIGNAL_NAME}"
        )


def joined(recordings: Iterable[Recording]) -> Recording:
    """Several recordings of one subject and condition as the runs of one recording.

    Their forcing functions may differ in lines, amplitudes and phases; one that only some of them
    have is zero in the others.

    Raises
    ------
    InputError
        If the sampling interval, length, run-in or the signals recorded differ.
    """
    recordings = list(recordings)
    if not recordings or not all(isinstance(own, Recording) for own in recordings):
        raise InputError("joined takes recordings, one at least")
    recordings, added = _with_all_forcing(recordings)
    first = recordings[0]
    for other in recordings[1:]:
        for what, a, b in (
            ("sampling interval", first.dt, other.dt),
            ("number of samples", first.samples, other.samples),
            ("run-in", first.run_in, other.run_in),
            ("set of signals", " ".join(first.signals), " ".join(other.signals)),
        ):
            equal = a == b if not isinstance(a, float) else bool(np.isclose(a, float(str(b))))
            if not equal:
                raise InputError(
                    f"{other.source}: the {what} ({b}) differs from that of {first.source} ({a}), "
                    "so the two cannot be runs of one recording"
                )

        for name, unit in other.units.items():
            if first.units.get(name, unit) != unit:
                raise InputError(
                    f"{other.source}: the unit of {name} ({unit}) differs from that of "
                    f"{first.source} ({first.units[name]}), so the two cannot be runs of one "
                    "recording"
                )
    every = [recording.arrays for recording in recordings]
    return first.with_arrays(
        {name: np.concatenate([own[name] for own in every]) for name in every[0]},
        lines=_all_lines(recordings),
        source=f"{first.source} and {len(recordings) - 1} more",
        treatment=tuple(dict.fromkeys([*(s for r in recordings for s in r.treatment), *added])),
    )


def _with_all_forcing(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """The same with zeros for forcing functions that others have, and a sentence on each."""
    found, added = list(recordings), []
    for name in ("ft", "fd"):
        without = [i for i, own in enumerate(found) if getattr(own, name) is None]
        if not 0 < len(without) < len(found):
            continue
        for i in without:
            lines = {key: own for key, own in found[i].lines.items() if key != name}
            signal: dict[str, Any] = {name: np.zeros_like(found[i].u)}
            found[i] = replace(found[i], **signal, lines=lines)
        which = ", ".join(found[i].source for i in without)
        added.append(f"{name} is taken for zero in {which}, where it is not recorded")
    return found, added


def _all_lines(recordings: Sequence[Recording]) -> dict[str, tuple[int, ...]]:
    """The lines of all recordings; of a forcing function for which one names none, none."""
    found = {}
    for name in ("ft", "fd"):
        moved = [r for r in recordings if name in r.lines or np.any(getattr(r, name))]
        if moved and all(name in r.lines for r in moved):
            found[name] = tuple(sorted({line for r in moved for line in r.lines[name]}))
    return found


def factor_of(text: str) -> tuple[float, str]:
    """The factor and the name in a text such as ``-3.49*fd``."""
    match = re.fullmatch(
        r"(-?)\s*(?:([\d.]+(?:[eE][-+]?\d+)?)\s*\*)?\s*(.*)", text.strip(), re.DOTALL
    )
    assert match is not None  # every text is a name at least
    sign, number, name = match.groups()
    return float(f"{sign}{number or 1}"), name


def times(factor: float, name: str) -> str:
    """The inverse of `factor_of`."""
    if abs(factor) == 1.0:
        return name if factor > 0.0 else f"-{name}"
    return f"{factor:.6g}*{name}"


def remembered(
    function: Callable[Concatenate[Recording, P], T],
) -> Callable[Concatenate[Recording, P], T]:
    """Work a function of a recording out once for each recording, which never changes.

    Parameters
    ----------
    function
        Its further arguments must be hashable; what it returns must be small, and nobody may
        change it.
    """
    known: WeakKeyDictionary[Recording, dict[tuple[Any, ...], T]] = WeakKeyDictionary()

    @wraps(function)
    def recalled(recording: Recording, /, *arguments: P.args, **named: P.kwargs) -> T:
        own = known.setdefault(recording, {})
        key = (arguments, tuple(named.items()))
        if key not in own:
            own[key] = function(recording, *arguments, **named)
        return own[key]

    return recalled


@remembered
def unit_sized(recording: Recording) -> Recording:
    """The recording as what computes takes it: without means over `LARGE_MEAN` standard deviations.

    Other recordings stay as they are.
    """
    arrays = recording.arrays
    held = {name: arrays[name] for name in recording.signals}
    means = {name: float(signal.mean()) for name, signal in held.items()}
    large = {n for n, mean in means.items() if abs(mean) > LARGE_MEAN * held[n].std() > 0.0}
    if large & {"e", "x", "ft"}:  # of which one is what the other two make it
        large |= held.keys() & {"e", "x", "ft"}
    for name in large:
        held[name] = held[name] - means[name]
    return recording.with_arrays(held) if large else recording
