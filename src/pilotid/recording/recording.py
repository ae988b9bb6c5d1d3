"""The one data object that every method reads."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import wraps
from operator import index
from typing import Any, Concatenate, NoReturn, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

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
LARGEST_VALUE = 1e100  # of a signal in any unit; squares and their sums must not overflow
LEAST_SCORED = 5.0  # s
#: The origin of x where it was not recorded: it is zero, and no signal.
ABSENT = "not recorded"
LEAD_IN = 3.0  # seconds from which a prediction starts, where no run-in is longer


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """One condition of one subject or simulation, in one or more runs.

    All signals are read-only arrays of shape (runs, samples), given as (samples,) of one run,
    on one uniform time base; the first `run_in` samples lie before t = 0 and are
    pre-history: methods may use them to start from, and score only what follows.

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
        Its transfer function, such as ``4/s^2``; methods close the loop with it.  Empty if unknown.
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
        own = vars(self)  # what is given becomes what is promised; then all is frozen
        source, element = printable(str(self.source)), str(self.controlled_element)
        own.update(source=source, controlled_element=element)
        try:
            own.update(dt=float(self.dt), run_in=index(self.run_in), lead_in=float(self.lead_in))
            lines = {name: tuple(map(index, few)) for name, few in self.lines.items() if len(few)}
        except (TypeError, ValueError, AttributeError) as error:
            self._refuse(f"{error}; dt and lead_in are seconds, run_in and lines whole numbers")
        own["lines"] = lines
        if not 0.0 < self.dt <= COARSEST:
            self._refuse(
                f"the sampling interval is {self.dt:.3g} s; a pilot's control needs at most "
                f"{COARSEST:g} s between samples; give the time in seconds (of ms "
                "with --map t=0.001*NAME)"
            )
        for name in ("u", *SIGNALS):
            value = getattr(self, name)
            if value is not None or name in "eux":
                own[name] = self._checked(name, value)
        for name in self.extra:
            require_extra_name(name)
        own["extra"] = {name: self._checked(name, value) for name, value in self.extra.items()}
        scored = self.duration - max(0.0, self.lead_in - self.run_in * self.dt)
        before = self.run_in >= 0 and self.lead_in >= 0.0  # nor is it NaN
        if not before or self.duration < SHORTEST or scored < LEAST_SCORED:
            self._refuse(
                f"the measurement window lasts {self.duration:.3g} s after a run-in of "
                f"{self.run_in} samples, and {scored:.3g} s of it are scored; at least "
                f"{SHORTEST:g} s and {LEAST_SCORED:g} s are needed: take a longer span, and store "
                "each signal as one column a run"
            )
        still = np.ptp(self.u[:, self.run_in :], axis=1) <= 1.0 / LARGEST_VALUE
        if still.any():
            self._refuse(
                f"the control u is constant in run {1 + int(np.argmax(still))}; map u to the "
                "recorded control, or leave that run out"
            )

    def _refuse(self, why: str) -> NoReturn:
        raise InputError(f"{self.source}: {why}")

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), tuple(vars(self).values())

    def _checked(self, name: str, value: ArrayLike) -> FloatArray:
        given = np.asarray(value)
        if given.dtype.kind not in "fiu" or np.ma.is_masked(value):
            self._refuse(
                f"signal {name} must be an array of real numbers, none of them masked; repair or "
                "cut the recording there"
            )
        array = np.atleast_2d(given.astype(float, order="C"))  # a row is one run
        shape = array.shape if name == "u" else self.u.shape
        if name not in ("e", "u", "x") and array.shape == (1, *shape[1:]):
            array = np.repeat(array, shape[0], axis=0)  # the same function in every run
        if array.ndim != 2 or not len(array) or array.shape != shape:
            self._refuse(
                f"signal {name} is of the shape {given.shape} and u of {shape}; all must be equal, "
                "(runs, samples)"
            )
        bad = ~(np.abs(array) <= LARGEST_VALUE)
        if bad.any():
            run, sample = (int(i) for i in np.argwhere(bad)[0])
            self._refuse(
                f"signal {name} is {array[run, sample]:g} at sample {sample + 1} of run {run + 1}; "
                "repair or cut the recording there"
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
        usual = {name: getattr(self, name) for name in SIGNALS}
        return {name: usual[name] for name in usual if usual[name] is not None} | {**self.extra}

    def with_arrays(self, arrays: Mapping[str, FloatArray], **changes: Any) -> Recording:
        """The same with other signals, and with other attributes.

        Parameters
        ----------
        arrays
            Signals by their names, shape (runs, run-in + samples); those that are not there stay.
        changes
            Attributes by their names.
        """
        usual: dict[str, Any] = {name: arrays[name] for name in arrays if name in SIGNALS}
        extra = {name: arrays.get(name, signal) for name, signal in self.extra.items()}
        return replace(self, **usual, **changes, extra=extra)

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
        first, last = round(start / self.dt), round(end / self.dt)
        if not 0 <= first < last <= self.samples:
            raise InputError(
                f"the span {start:g}:{end:g} must lie in the window of {self.source}, which ends "
                f"at {self.duration:.4g} s"
            )
        share = (last - first) / self.samples
        lines = {name: np.array(lines) * share for name, lines in self.lines.items()}
        kept = {
            name: tuple(np.rint(line).astype(int).tolist())
            for name, line in lines.items()
            if np.all(np.abs(line - np.rint(line)) < 1e-6)
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
        present, place = factor_of(self.origin.get(name, name))
        return f"{name}={times(factor * present, place)}"

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
    have is zero in the others.  Of run-ins that differ the ends count that all have.

    Raises
    ------
    InputError
        If the sampling interval, length or the signals recorded differ.
    """
    recordings = _with_all_forcing(list(recordings))
    first = recordings[0]
    for other in recordings[1:]:
        for what, a, b in (
            ("sampling interval", f"{first.dt:.5g}", f"{other.dt:.5g}"),
            ("number of samples", first.samples, other.samples),
            ("set of signals", " ".join(first.signals), " ".join(other.signals)),
            ("set of units", {**other.units, **first.units}, {**first.units, **other.units}),
        ):
            if a != b:
                raise InputError(
                    f"{other.source}: the {what} ({b}) differs from that of {first.source} ({a}), "
                    "so the two cannot be runs of one recording"
                )
    shortest = min(recording.run_in for recording in recordings)
    every = [
        {
            name: signal[:, recording.run_in - shortest :]
            for name, signal in recording.arrays.items()
        }
        for recording in recordings
    ]
    lines = {}
    for name in ("ft", "fd"):  # none for a function of which one recording names none
        moved = [r for r in recordings if name in r.lines or np.any(getattr(r, name))]
        if moved and all(name in r.lines for r in moved):
            lines[name] = tuple(sorted({line for r in moved for line in r.lines[name]}))
    return first.with_arrays(
        {name: np.concatenate([arrays[name] for arrays in every]) for name in every[0]},
        lines=lines,
        run_in=shortest,
        source=f"{first.source} and {len(recordings) - 1} more",
        treatment=tuple(dict.fromkeys(words for r in recordings for words in r.treatment)),
    )


def _with_all_forcing(recordings: list[Recording]) -> list[Recording]:
    """The same with zeros for forcing functions that others have, and a sentence on each."""
    for name in ("ft", "fd"):
        lacking = [place for place, r in enumerate(recordings) if getattr(r, name) is None]
        which = ", ".join(recordings[place].source for place in lacking)
        words = f"{name} is taken for zero in {which}, where it is not recorded"
        for place in lacking if len(lacking) < len(recordings) else ():
            r = recordings[place]
            lines, treatment = {**r.lines, name: ()}, (*r.treatment, words)
            zero = {name: np.zeros_like(r.u)}
            recordings[place] = r.with_arrays(zero, lines=lines, treatment=treatment)
    return recordings


def factor_of(text: str) -> tuple[float, str]:
    """The factor and the name in a text such as ``-3.49*fd``."""
    match = re.fullmatch(
        r"(-?)\s*(?:((?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*\*)?\s*(.*)", text.strip(), re.DOTALL
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
        answers = known.setdefault(recording, {})
        key = (arguments, tuple(named.items()))
        if key not in answers:
            answers[key] = function(recording, *arguments, **named)
        return answers[key]

    return recalled
