"""One fit of a study: what crosses to another process, and the row that comes back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from pilotid.bounds import bounds
from pilotid.datasets import Population, Scenario, simulate
from pilotid.datasets.experiments import bound_of, experiment_of
from pilotid.datasets.forcing import Multisine
from pilotid.datasets.named import AnyScenario
from pilotid.datasets.simulation import lines_in
from pilotid.estimates.estimate import Estimate, Outcome
from pilotid.estimates.method import Method, Searching, identify
from pilotid.estimates.warnings import OPEN
from pilotid.jobs import Loss
from pilotid.methods import label_of
from pilotid.naming.code import reason, unpacked
from pilotid.pilot.element import ControlledElement
from pilotid.pilot.model import PilotModel
from pilotid.recordings.checks import remarks
from pilotid.recordings.recording import Recording
from pilotid.study.store import Draw, ParameterTruth, Result, Unit, number
from pilotid.support.numbers import draw_rng, fit_rng, recording_rng, start_rng
from pilotid.support.remarks import codes_of
from pilotid.support.types import one_line

#: Outcomes that another try may mend; an error that the code makes comes again.
OUTSIDE = (Outcome.CRASHED, Outcome.OUT_OF_MEMORY, Outcome.TIMED_OUT, Outcome.DIED)

LONGEST_TOLD = 300  # characters of remarks that a study keeps of a fit


@dataclass(frozen=True)
class Task:
    """A fit to do.

    Attributes
    ----------
    unit
        Which one.
    seed
        Seed of all random numbers.
    content
        Scenario and method, see `pilotid.naming.code.packed`.
    """

    unit: Unit
    seed: int
    content: bytes


def run_task(task: Task) -> Result:
    """Simulate and identify; whatever goes wrong is a result."""
    unit, seed = task.unit, task.seed
    draw: Draw | None = None
    try:
        held: tuple[AnyScenario, Method] = unpacked(task.content)
        origin, method = held
        replication = 0 if origin.one_recording else unit.replication
        scenario, draw = scenario_of(origin, seed, replication)
        recording = recording_of(origin, seed, replication)
        model = started(scenario, seed, unit.replication)
        # A label of the user's own moves no number.
        rng = fit_rng(seed, label_of(method), unit.scenario, unit.replication)
        estimate = identify(method, recording, model, rng)
        excess = None if draw is None else excess_of(method, recording, estimate, scenario)
        found = _result(unit, estimate, excess, draw)
        shown = remarks_of(origin, seed, replication)
        return replace(found, remarks=told(shown, estimate))
    except MemoryError as error:
        return Result(unit, Outcome.OUT_OF_MEMORY.slug, one_line(str(error)), draw=draw)
    except BaseException as error:  # an interruption too: the user's go to another process
        return Result(unit, Outcome.CRASHED.slug, one_line(reason(error)), draw=draw)


@lru_cache(maxsize=2)  # methods of a replication come one after the other
def recording_of(origin: AnyScenario, seed: int, replication: int) -> Recording:
    """The recording of a replication; its signals are read-only."""
    scenario, _ = scenario_of(origin, seed, replication)
    return simulate(scenario, recording_rng(seed, scenario.name, replication))


@lru_cache(maxsize=8)
def remarks_of(origin: AnyScenario, seed: int, replication: int) -> tuple[str, ...]:
    """The remarks on the recording of a replication."""
    return remarks(recording_of(origin, seed, replication))


def told(remarked: tuple[str, ...], estimate: Estimate) -> str:
    """What a user would be told against a recording and an estimate, on one line.

    Remarks on the recording come first and begin with ``recording:``, as `pilotid fit` has them.
    What a sound recording leaves open, such as a gain and a lead that trade off, is left out.

    Parameters
    ----------
    remarked
        The remarks on the recording.
    estimate
        The estimate.
    """
    own = [remark for remark in estimate.remarks if codes_of([remark])[0] not in OPEN]
    found = [*(f"recording: {remark}" for remark in remarked), *own]
    line = " | ".join(found)
    return line if len(line) <= LONGEST_TOLD else f"{line[: LONGEST_TOLD - 4]} ..."


def excess_of(
    method: Method, recording: Recording, estimate: Estimate, scenario: Scenario
) -> float | None:
    """The criterion of a fit over that of a search by its method which starts at the truth.

    None where the method has no criterion, or where that search fails, which is no fault of
    the fit.
    """
    if not (isinstance(method, Searching) and estimate.outcome.usable):
        return None
    try:
        sets = np.array([estimate.values, scenario.values])
        own, best = method.criteria_from(recording, estimate.model, sets)
        return number(own - best)
    except Exception:
        return None


def started(scenario: Scenario, seed: int, replication: int) -> PilotModel:
    """The scenario's model with the initial guesses of a replication."""
    if not scenario.start_spread:
        return scenario.model
    rng = start_rng(seed, scenario.name, replication)
    factors = 1.0 + scenario.start_spread * rng.uniform(-1.0, 1.0, len(scenario.truth))
    starts = scenario.values * factors
    return scenario.model.with_start(dict(zip(scenario.model.keys, starts.tolist(), strict=True)))


def given_up(task: Task, loss: Loss, why: str) -> Result:
    """The row of a fit that gave no estimate at all."""
    return Result(task.unit, Outcome[loss.name].slug, why)


def _result(unit: Unit, e: Estimate, excess: float | None, draw: Draw | None) -> Result:
    known = tuple(
        (q.key, number(q.value), number(q.std_error), number(q.lower), number(q.upper))
        for q in e.parameters
    )
    ended = unit, e.outcome.slug, e.message, e.outcome.usable, number(e.vaf), int(e.iterations)
    return Result(*ended, e.draws is not None, number(e.seconds), known, excess, draw)


# ------------------------------------------------------------ what a population draws

#: Kinds of elements by which coefficients below the highest are zero.
KINDS = {
    (): "K",
    (True,): "K/s",
    (False,): "first order",
    (True, True): "K/s^2",
    (False, True): "K/(s(s+a))",
    (False, False): "second order",
}


@lru_cache(maxsize=8)  # methods of a replication come one after the other
def scenario_of(origin: AnyScenario, seed: int, replication: int) -> tuple[Scenario, Draw | None]:
    """The scenario of a replication, and what is to be kept of it if it was drawn."""
    scenario = origin.drawn(draw_rng(seed, origin.name, replication))
    if not isinstance(origin, Population):
        return scenario, None
    return scenario, Draw(scenario.model.name, truths_of(scenario), facts_of(scenario))


def truths_of(scenario: Scenario) -> tuple[ParameterTruth, ...]:
    """True values, and the bounds of the whole record with the remnant's spectrum known.

    Raises
    ------
    InputError
        If no bounds can be given, for example because the loop is unstable.
    """
    if scenario.changes:
        deviations = bound_of(scenario)
    else:
        deviations = np.sqrt(np.diag(bounds(experiment_of(scenario)).full))
    known = zip(scenario.model.parameters, scenario.values, deviations, strict=True)
    return tuple(
        ParameterTruth(p.key, p.unit, float(value), number(float(deviation)))
        for p, value, deviation in known
    )


def facts_of(scenario: Scenario) -> dict[str, str | float]:
    """What was drawn, but for the pilot's parameters: words and numbers."""
    remnant = scenario.remnant
    forced = {"target": scenario.target, "disturbance": scenario.disturbance}
    given = {name: f for name, f in forced.items() if f is not None}
    sines = [f for f in given.values() if isinstance(f, Multisine)]
    periodic = bool(sines) and all(lines_in(f, scenario.duration) for f in sines)
    return {
        "element": element_kind(scenario.element),
        "element_name": scenario.element.name,
        "forcing": "both" if len(given) == 2 else "".join(given) or "none",
        "periodic": "periodic" if periodic and len(sines) == len(given) else "aperiodic",
        "remnant": remnant_kind(scenario),
        "remnant_shape": remnant.shape,
        "remnant_order": remnant.order,
        "remnant_enters": remnant.enters,
        "remnant_level": remnant.level,
        "dt": scenario.dt,
        "duration": scenario.duration,
        "run_in": scenario.run_in,
        "runs": scenario.runs,
    }


def element_kind(element: ControlledElement) -> str:
    """The kind of a controlled element, such as ``K/s^2``."""
    zero = tuple(c == 0.0 for c in element.denominator[1:])
    return KINDS.get(zero, "other") if len(element.numerator) == 1 else "other"


def remnant_kind(scenario: Scenario) -> str:
    """The family of a remnant, in a word or two."""
    remnant = scenario.remnant
    if remnant.freedom is not None:
        return "heavy tails"
    if remnant.enters != "control":
        return f"before {remnant.enters}"
    return f"order {remnant.order}" if remnant.shape == "low-pass" else remnant.shape
