"""Populations: scenarios in which every replication has a pilot and a loop of its own.

A result on one pilot is not a result.  A population draws the pilot, the controlled
element, the forcing functions, the remnant, the sampling rate, the length and the number of
runs, each from the range of published experiments, and keeps what makes a stable loop with
a sensible margin:

- pilots: ranges around the estimates of AIAA 2008-7109; Zaal, JGCD 39(5) 2016 (gains and
  leads that change by a factor of three, delays .26 to .32 s); Pool, Harder and van Paassen
  2016 (leads .3 to .7 s, lags 1 to 3 s, motion gain 3 with .19 s);
- crossover 1 to 5 rad/s over controlled elements K, K/s and K/s^2 (McRuer and Jex, IEEE
  Trans. HFE-8, 1967);
- forcing functions: sums of 7 to 13 sines per signal, from about .3 to 17 rad/s, with the
  spectrum of AIAA 2008-7109.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from pilotid.datasets.recorder import drawn_recorder
from pilotid.datasets.scenarios import Scenario
from pilotid.datasets.signals import Multisine, Remnant
from pilotid.datasets.simulation import white_level
from pilotid.model.catalogue import MODELS as CATALOGUE
from pilotid.model.element import ControlledElement
from pilotid.model.loops import is_stable, margins, open_loops
from pilotid.model.model import PilotModel
from pilotid.support.types import FloatArray, InputError

T = TypeVar("T")

#: Ranges of the parameters, drawn evenly on a logarithmic scale; gains of the visual channel
#: follow from the crossover frequency.
RANGES = {
    "Kvis": (0.04, 1.2),
    "tlead": (0.25, 4.0),
    "tlag": (0.25, 3.0),
    "tdvis": (0.16, 0.42),
    "Kvest": (0.5, 3.0),
    "tdvest": (0.14, 0.38),
    "Km": (0.05, 2.0),
    "tdm": (0.14, 0.38),
    "fnm": (6.5, 15.0),
    "dnm": (0.12, 0.65),
}
CROSSOVER = (1.0, 5.0)  # rad/s, of the target loop
SENSITIVITY = 4.0  # largest |1/(1 + L)|: the paper's single-channel pilot has 3.6
ASIDE = 2.0  # least ratio of lead and lag time, or of lag and lead time
ELEMENTS = {
    "multi": ("K/s^2", "K/(s(s+a))", "second order"),
    "rate": ("K/s^2", "K/(s(s+a))"),
    "single": ("K/s^2", "K/(s(s+a))", "second order"),
    "lead-lag": ("K", "K/s", "second order"),
}
MODELS = {name: CATALOGUE[name] for name in ELEMENTS}


@dataclass(frozen=True)
class Population:
    """A distribution of scenarios.

    Attributes
    ----------
    name, description
        For the command line and reports.
    models
        Names of the models that pilots follow, one drawn for each replication; one named
        twice is drawn twice as often.
    exotic
        Whether remnants are outside the families of low-pass filters.
    recorded
        Whether a recorder drawn at random stands between loop and file.
    aperiodic
        Whether forcing functions have no whole period in the recording.
    intervals
        Sampling intervals [s].
    durations
        Range of the measurement window [s].
    runs
        Numbers of runs.
    """

    name: str
    description: str
    models: tuple[str, ...] = ("multi", "multi", "multi", "rate", "lead-lag")
    exotic: bool = False
    recorded: bool = False
    aperiodic: bool = False
    intervals: tuple[float, ...] = (0.01, 0.02)
    durations: tuple[float, float] = (60.0, 120.0)
    runs: tuple[int, ...] = (1, 1, 1, 2, 3, 5)
    one_recording = False  # every replication has its own

    def __post_init__(self) -> None:
        if unknown := set(self.models) - set(MODELS):
            there = ", ".join(MODELS)
            raise ValueError(f"models must be of {there}, not {', '.join(sorted(unknown))}")
        numbers = (*self.intervals, *self.durations, *self.runs)
        if not (self.models and self.intervals and self.runs and min(numbers) > 0):
            raise ValueError("give models, and intervals, durations and runs above 0")

    def drawn(self, rng: np.random.Generator) -> Scenario:
        """One scenario of the population; it bears the population's name.

        Draws whose loop is unstable, or has less than a sensible margin, are thrown away.
        """
        # Kinds are drawn once, so that what is thrown away leaves their shares as they are.
        model = MODELS[_one(self.models, rng)]
        kind = _one(ELEMENTS[model.name], rng)
        while True:
            scenario = self._drawn(model, kind, rng)
            if scenario is not None and reachable(scenario):
                return scenario

    def _drawn(self, model: PilotModel, kind: str, rng: np.random.Generator) -> Scenario | None:
        element = drawn_element(kind, rng)
        truth = drawn_pilot(model, element, rng)
        if truth is None:
            return None
        dt = _one(self.intervals, rng)
        duration = round(_between(*self.durations, rng) / dt) * dt
        target, disturbance = drawn_forcing(element, duration, rng, aperiodic=self.aperiodic)
        # Two channels can be told apart by two forcing functions; one needs no more than one.
        left_out = rng.integers(3) if len(model.channels) == 1 else 0
        return Scenario(
            name=self.name,
            description=self.description,
            model=model,
            truth=tuple(truth.tolist()),
            element=element,
            target=None if left_out == 1 else target,
            disturbance=None if left_out == 2 else disturbance,
            remnant=drawn_remnant(rng, exotic=self.exotic),
            duration=duration,
            run_in=round(_one((0.0, 3.0, 8.0), rng) / dt) * dt,
            dt=dt,
            runs=_one(self.runs, rng),
            recorder=drawn_recorder(rng) if self.recorded else None,
        )


def drawn_element(kind: str, rng: np.random.Generator) -> ControlledElement:
    """A controlled element of a kind that `ELEMENTS` names."""
    gain = _between(1.0, 20.0, rng)
    bottom = {"K": (1.0,), "K/s": (1.0, 0.0), "K/s^2": (1.0, 0.0, 0.0)}.get(kind)
    name = kind.replace("K", f"{gain:g}")
    if kind == "K/(s(s+a))":
        bottom = (1.0, _between(0.2, 6.0, rng), 0.0)
        name = f"{gain:g}/(s(s{bottom[1]:+g}))"
    elif bottom is None:
        frequency, damping = _between(0.5, 3.0, rng), _between(0.3, 1.2, rng)
        bottom = (1.0, 2.0 * damping * frequency, frequency**2)
        name = f"{gain:g}/(s^2{bottom[1]:+g}s{bottom[2]:+g})"
    return ControlledElement((gain,), bottom, name=name)


def drawn_pilot(
    model: PilotModel, element: ControlledElement, rng: np.random.Generator
) -> FloatArray | None:
    """Parameters of a pilot in model order, None where the draw makes no sensible loop.

    The visual gain puts the visual channel's own crossover where it was drawn.
    """
    values = {key: _between(*RANGES[key], rng) for key in model.keys}
    if "tlag" in values and abs(math.log(values["tlead"] / values["tlag"])) < math.log(ASIDE):
        return None  # a lead and a lag that all but cancel are neither
    # Gains on motion are in units of the output's derivatives, whatever the element makes of a
    # unit of control: scaled to the paper's gain of 4.
    scale = 4.0 / float(np.abs(element.response(np.array([4.0])))[0]) / 16.0
    for key in {"Kvest", "Km"} & values.keys():
        values[key] *= scale
    crossover = _between(*CROSSOVER, rng)
    truth = model.vector({**values, "Kvis": 1.0})
    visual = model.response(np.array([crossover]), truth)[0, 0]
    plant = element.response(np.array([crossover]))[0]
    truth = model.vector({**values, "Kvis": 1.0 / abs(visual * plant)})
    inside = (model.lower < truth) & (truth < model.upper)
    if not inside.all() or not sensible(model, truth, element):
        return None
    return truth


def sensible(model: PilotModel, truth: FloatArray, element: ControlledElement) -> bool:
    """Whether the loop crosses over where pilots do, and is stable with a margin."""
    target, _ = margins(model, truth, element)
    last = max((target.crossover, *target.others))  # a resonance must not cross over far above
    if not (0.5 * CROSSOVER[0] <= last <= 1.2 * CROSSOVER[1]):
        return False
    omega = np.geomspace(0.05, 60.0, 400)
    loops = open_loops(model, truth, element, omega)
    if any(np.max(1.0 / np.abs(1.0 + loop)) > SENSITIVITY for loop in loops):
        return False
    return is_stable(model, truth, element)


def reachable(scenario: Scenario) -> bool:
    """Whether the remnant can have the power drawn for it, which the loop limits."""
    try:
        white_level(scenario)
    except InputError:
        return False
    return True


def drawn_forcing(
    element: ControlledElement, duration: float, rng: np.random.Generator, *, aperiodic: bool
) -> tuple[Multisine, Multisine]:
    """Target and disturbance: interleaved lines, or many lines without a common period."""
    if aperiodic:
        # The period is no whole number of windows, nor the window one of periods.
        period = duration * _between(2.3, 2.7, rng)
        count = 60
    else:
        period = duration / _one((1, 1, 2), rng)
        count = int(rng.integers(7, 14))
    lines = _lines(2 * count, period, rng)
    size = _between(0.3, 3.0, rng)
    target = _shaped(lines[::2], period, rng)
    disturbance = _shaped(lines[1::2], period, rng)
    # The disturbance has that shape at the output of the element.
    plant = np.abs(element.response(disturbance.omega))
    referred = tuple(np.array(disturbance.amplitudes) / plant * size)
    return target, replace(disturbance, amplitudes=tuple(float(a) for a in referred))


def _lines(count: int, period: float, rng: np.random.Generator) -> list[int]:
    """Different lines from about 0.3 to about 17 rad/s, evenly on a logarithmic scale."""
    first = max(2.0, 0.3 * period / (2.0 * math.pi))
    ideal = np.geomspace(first, 17.0 * period / (2.0 * math.pi), count)
    lines: list[int] = []
    for wish in ideal * np.exp(rng.uniform(-0.1, 0.1, count)):
        lines.append(max(round(float(wish)), lines[-1] + 1 if lines else 1))
    return lines


def _shaped(lines: Sequence[int], period: float, rng: np.random.Generator) -> Multisine:
    """A multisine of variance 1 with the spectrum of AIAA 2008-7109 and random phases."""
    omega = 2.0 * np.pi * np.array(lines) / period
    # Denser lines share the power of their band.
    shape = np.abs((1.0 + 0.1j * omega) ** 2 / (1.0 + 0.8j * omega) ** 2)
    shape = shape * np.sqrt(np.gradient(omega) / omega)
    amplitudes = shape * math.sqrt(2.0 / float(np.sum(shape**2)))
    plain = Multisine(tuple(lines), tuple(amplitudes.tolist()), (0.0,) * len(lines), period)
    return plain.with_random_phases(rng)


def drawn_remnant(rng: np.random.Generator, *, exotic: bool) -> Remnant:
    """A remnant of 5 to 30 % of the control's power."""
    base = Remnant(
        order=int(rng.integers(1, 3)),
        frequency=_between(1.5, 13.0, rng),
        damping=_between(0.25, 1.2, rng),
        level=_between(0.05, 0.30, rng),
        level_is="ratio",
    )
    if not exotic:
        return base
    match int(rng.integers(6)):
        case 0:
            return replace(base, order=1, enters="neuromuscular")
        case 1:
            return replace(base, shape="band-pass", second=_between(0.3, 2.0, rng))
        case 2:
            return replace(base, shape="notch", second=_between(2.0, 10.0, rng))
        case 3:
            return replace(base, shape="two processes", second=_between(5.0, 15.0, rng))
        case 4:
            return replace(base, shape="fractional", slope=_between(0.5, 1.8, rng))
    return replace(base, freedom=4.0)


def _between(low: float, high: float, rng: np.random.Generator) -> float:
    """A number drawn evenly on a logarithmic scale."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _one(things: Sequence[T], rng: np.random.Generator) -> T:
    return things[int(rng.integers(len(things)))]


#: Populations by the name that the command line takes.
POPULATIONS: dict[str, Population] = {
    p.name: p
    for p in (
        Population("population-usual", "pilots, loops and low-pass remnants at random"),
        Population(
            "population-single",
            "the same for the visual channel alone",
            models=("single",),
        ),
        Population(
            "population-exotic",
            "remnants of other shapes: before the neuromuscular system, band-pass, notch, two "
            "processes, a slope that is no whole number, heavy tails",
            exotic=True,
        ),
        Population(
            "population-aperiodic",
            "forcing functions without a period in the recording",
            aperiodic=True,
        ),
        Population(
            "population-recorded",
            "recorders: rates from 25 to 200 Hz, anti-alias filters, noise, converters, text files",
            recorded=True,
            intervals=(0.04, 0.02, 0.01, 0.005),
        ),
        Population("population-short", "recordings of 30 s", durations=(30.0, 30.0), runs=(1,)),
    )
}
