"""Scenarios: everything that defines a simulated data set, by name.

A new scenario is one entry in `SCENARIOS`; `pilotid.datasets.named` finds it by its name.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from pilotid.datasets.recorder import Recorder
from pilotid.datasets.signals import (
    PERIOD,
    Forcing,
    Remnant,
    adaptation_target,
    half_and_half_step,
    paper_disturbance,
    paper_target,
    white,
)
from pilotid.model.catalogue import ADAPTING, MULTI, SINGLE
from pilotid.model.element import ControlledElement, element_named
from pilotid.model.model import PilotModel
from pilotid.recording.recording import SIGNALS
from pilotid.support.types import FloatArray, InputError

#: The pilots of AIAA 2008-7109 with motion (Kvis, tlead, tdvis, Kvest, tdvest, fnm, dnm) and
#: without (Kvis, tlead, tdvis, fnm, dnm).
PILOT_IN_MOTION = (0.17, 2.93, 0.32, 1.59, 0.29, 12.0, 0.3)
PILOT_AT_REST = (0.32, 1.68, 0.39, 12.0, 0.3)

#: Units of signals unless a scenario has others.
DEGREES = tuple((name, "deg") for name in SIGNALS)


Kind = Literal["threshold", "quantised", "saturated"]


@dataclass(frozen=True)
class Violation:
    """A stick that is not linear, as methods assume.

    Attributes
    ----------
    kind
        ``threshold`` (the control is zero while the command is smaller than `size`),
        ``quantised`` (the control has steps of `size`), ``saturated`` (it is clipped at plus and
        minus `size`).
    size
        In root mean squares of the linear loop's control.
    """

    kind: Kind
    size: float

    def stick(self, command: FloatArray, rms: float) -> FloatArray:
        """The control that a stick makes of a command.

        Parameters
        ----------
        command
            Command, any shape.
        rms
            Root mean square of the linear loop's control, in the command's unit.
        """
        size = self.size * rms
        match self.kind:
            case "threshold":
                return np.where(np.abs(command) < size, 0.0, command)
            case "quantised":
                return np.asarray(size * np.round(command / size))
        return np.clip(command, -size, size)


@dataclass(frozen=True)
class ElementChange:
    """How the coefficients of a controlled element pass to those of another.

    Of N/D and N2/D2, both with a constant numerator, a leading coefficient 1 and the same order,
    it is the differential equation whose coefficients go along the sigmoid of
    `pilotid.model.channel.Changing`.

    Attributes
    ----------
    after
        What the element becomes.
    middle
        Middle of the change, from the start of the measurement window [s].
    rate
        Its rate [1/s].
    """

    after: ControlledElement
    middle: float
    rate: float


@dataclass(frozen=True)
class Scenario:
    """Truth, controlled element, forcing functions, remnant and length of a data set.

    Attributes
    ----------
    name, description
        For the command line and reports.
    model, truth
        The pilot, and its parameters in model order.
    element
        Controlled element.
    target, disturbance
        Forcing functions, None for none.
    remnant
        The remnant.
    duration, run_in, dt
        Measurement window, run-in before it, sampling interval [s].
    runs
        Runs per recording, with the same forcing and independent remnants.
    start_spread
        Where methods start: 0 for the model's own, generic initial guesses; otherwise they are
        drawn within this share of the truth, for each replication the same for all methods.
    one_recording
        Whether all replications fit the same recording.
    violation
        What in the stick is not linear, None for nothing.
    change
        What the controlled element becomes, and when; None for a constant one.
    recorder
        What stands between the loop and its file; None for nothing.
    units
        Names of signals and their units.
    family
        ``violation`` or ``recorder`` where a warning is due, empty for others.
    """

    name: str
    description: str
    model: PilotModel = MULTI
    truth: tuple[float, ...] = PILOT_IN_MOTION
    element: ControlledElement = field(default_factory=lambda: element_named("4/s^2"))
    target: Forcing | None = field(default_factory=paper_target)
    disturbance: Forcing | None = field(default_factory=paper_disturbance)
    remnant: Remnant = field(default_factory=Remnant)
    duration: float = PERIOD
    run_in: float = 8.0
    dt: float = 0.02
    runs: int = 1
    start_spread: float = 0.0
    one_recording: bool = False
    violation: Violation | None = None
    change: ElementChange | None = None
    recorder: Recorder | None = None
    units: tuple[tuple[str, str], ...] = DEGREES
    family: str = ""

    @property
    def values(self) -> FloatArray:
        """True parameters in model order, shape (parameters,)."""
        return self.model.vector(dict(zip(self.model.keys, self.truth, strict=True)))

    @property
    def changes(self) -> bool:
        """Whether pilot or controlled element change in time, as the truth says."""
        return self.change is not None or self.model.changes

    @property
    def constant_ends(self) -> tuple[tuple[Scenario, float], ...]:
        """What it is before and after all changes, constant, and the share of the window of each.

        A constant scenario is itself all the time.
        """
        if not self.changes:
            return ((self, 1.0),)
        middle = 0.5 * self.duration if self.change is None else self.change.middle
        share = float(np.clip(middle / self.duration, 0.0, 1.0))
        element = self.element if self.change is None else self.change.after
        before, after = (self.values[i] for i in self.model.ends)
        plain = replace(self, model=self.model.constant, change=None)
        return (
            (replace(plain, truth=tuple(before.tolist())), share),
            (replace(plain, truth=tuple(after.tolist()), element=element), 1.0 - share),
        )

    def drawn(self, rng: np.random.Generator) -> Scenario:
        """Itself: every replication has the same pilot; see `pilotid.datasets.population`."""
        return self


NOMINAL = Scenario("nominal", "both forcing functions, remnant gain 0.4 (Fig. 3, Table 3)")


def _varied(name: str, description: str, **changes: Any) -> Scenario:
    """A scenario that differs from the nominal one in some attributes."""
    return replace(NOMINAL, name=name, description=description, **changes)


def _of_the_paper() -> list[Scenario]:
    # The paper raises the disturbance and the remnant four times in these cases.
    louder = replace(NOMINAL.remnant, level=4.0 * NOMINAL.remnant.level)
    at_rest = "visual channel alone, both forcing functions, remnant gain 0.4"
    control_case = "nominal with a white remnant of 15 % power: every method's control case"
    disturbed = "disturbance alone, forcing and remnant four times nominal (Table 3)"
    stepped = "step disturbance alone, forcing and remnant four times nominal (Table 3)"
    starts = "one nominal recording, initial guesses within 40 % of the truth (Fig. 5)"
    loud = paper_disturbance().scaled(4.0)
    step, jump = (half_and_half_step(NOMINAL.duration, size) for size in (1.0, 4.0))
    return [
        NOMINAL,
        _varied("single", at_rest, model=SINGLE, truth=PILOT_AT_REST),
        _varied("white-remnant", control_case, remnant=white(0.15)),
        _varied("disturbance-only", disturbed, target=None, disturbance=loud, remnant=louder),
        _varied("target-only", "target alone (Table 3)", disturbance=None),
        _varied("disturbance-step", stepped, target=None, disturbance=jump, remnant=louder),
        _varied("target-step", "step target alone (Table 3)", target=step, disturbance=None),
        *(
            _varied(
                f"remnant-{gain:.1f}",
                f"nominal with remnant gain {gain:.1f} (Figs 6 and 7)",
                remnant=replace(NOMINAL.remnant, level=gain),
            )
            for gain in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
        ),
        _varied("starts", starts, start_spread=0.4, one_recording=True),
        *(
            _varied(f"runs-{runs}", f"nominal with {runs} runs, fitted jointly", runs=runs)
            for runs in (2, 5, 10)
        ),
    ]


def _violated() -> list[Scenario]:
    cases: dict[Kind, tuple[float, str]] = {
        "threshold": (0.25, "that is zero while the command is below a quarter of its rms"),
        "quantised": (0.2, "in steps of a fifth of its rms"),
        "saturated": (1.5, "that is clipped at 1.5 times its rms"),
    }
    return [
        _varied(
            f"violation-{kind}",
            f"nominal with a control {words}",
            violation=Violation(kind, size),
            family="violation",
        )
        for kind, (size, words) in cases.items()
    ]


def _recorded() -> list[Scenario]:
    cases: dict[str, tuple[str, Recorder]] = {
        "noise": (
            "noise of .3 % of the rms on e and x",
            Recorder(noise=(0.0, 0.0, 3e-3), makes_error=True),
        ),
        "rounded": ("a text file of three decimals", Recorder(decimals=3)),
        "bits": ("a converter of 10 bits", Recorder(bits=10, makes_error=True)),
        "filtered": ("a low-pass without phase at 3 Hz on all signals", Recorder(smoothed=3.0)),
        "filtered-control": (
            "an anti-alias filter at 10 Hz on the control alone",
            Recorder(order=2, corner=0.4, filtered=("u",)),
        ),
        "late": ("a control recorded late by a sample", Recorder(late=(("u", 1),))),
        "lost": ("0.2 % of the samples of e, u and x lost", Recorder(lost=0.002)),
        "jitter": ("times of samples that jitter by half an interval", Recorder(jitter=0.5)),
    }
    return [
        _varied(f"recorder-{name}", f"nominal with {words}", recorder=recorder, family="recorder")
        for name, (words, recorder) in cases.items()
    ]


def _changing() -> list[Scenario]:
    """The Monte Carlo simulations of Zaal (JGCD 39(5) 2016), roll."""
    middle = 50.0 - (90.0 - PERIOD)  # 50 s after the start of a run of 90 s
    hard = ControlledElement((90.0,), (1.0, 6.0, 0.0), name="90/(s(s+6))")
    easy = ControlledElement((30.0,), (1.0, 0.2, 0.0), name="30/(s(s+0.2))")
    return [
        Scenario(
            f"adapting-{name}",
            f"an element that becomes harder to control at {rate:g}/s half-way, and a pilot who "
            f"adapts to it; target alone, remnant of 15 % power (Zaal 2016)",
            model=ADAPTING,
            truth=(0.09, 0.07, 0.4, 1.2, middle, rate, 0.28, 11.25, 0.35),
            element=hard,
            change=ElementChange(easy, middle, rate),
            target=adaptation_target(),
            disturbance=None,
            remnant=Remnant(order=1, frequency=5.0, level=0.15, level_is="ratio"),
            run_in=90.0 - PERIOD,
            dt=0.01,
        )
        for name, rate in (("slow", 0.5), ("fast", 100.0))
    ]


#: Scenarios by the name that the command line takes.
SCENARIOS: dict[str, Scenario] = {
    s.name: s
    for s in (
        *_of_the_paper(),
        *_violated(),
        *_recorded(),
        *_changing(),
    )
}


def checked(scenario: object) -> Scenario:
    """A scenario, if its truth is one of its model, and stays with it.

    Raises
    ------
    InputError
        If it is no scenario, or its truth has not as many numbers as its model parameters; if
        the model would carry the truth to the methods.
    """
    if not isinstance(scenario, Scenario):
        raise InputError(f"{scenario!r}: is no Scenario")
    model, why = scenario.model, ""
    if len(scenario.truth) != len(model.keys):
        why = f"its truth must be {len(model.keys)} numbers, for {', '.join(model.keys)}"
    elif model.extra:
        why = f"its model acts on {', '.join(model.extra)}, which no simulation makes"
    elif not scenario.start_spread and scenario.truth == tuple(model.start):
        why = (
            "its truth is the start of its model, which is handed to every method; give the model "
            "another start (PilotModel.with_start)"
        )
    if why:
        raise InputError(f"scenario {scenario.name}: {why}")
    return scenario
