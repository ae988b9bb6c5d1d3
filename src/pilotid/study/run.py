"""One fit of a study: what crosses to another process, and the row that comes back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from pilotid.datasets import Population, Scenario, simulate
from pilotid.datasets.bounds import bounds
from pilotid.datasets.experiments import bound_of, experiment_of
from pilotid.datasets.named import AnyScenario
from pilotid.estimate.estimate import Estimate, Outcome, failed
from pilotid.estimate.method import Method, identify, signals_in
from pilotid.estimate.warnings import told
from pilotid.methods import label_of
from pilotid.model.element import ControlledElement
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.study.table import Fit
from pilotid.support.jobs import Loss
from pilotid.support.naming import unpacked
from pilotid.support.numbers import draw_rng, fit_rng, recording_rng, start_rng
from pilotid.support.store import Key, number
from pilotid.support.types import one_line, reason

#: Outcomes that another try may mend; an error that the code makes comes again.
OUTSIDE = (Outcome.CRASHED, Outcome.OUT_OF_MEMORY, Outcome.TIMED_OUT, Outcome.DIED)


@dataclass(frozen=True)
class Task:
    """A fit to do.

    Attributes
    ----------
    key
        Scenario, method and replication.
    seed
        Seed of all random numbers.
    content
        Scenario and method, see `pilotid.support.naming.packed`.
    """

    key: Key
    seed: int
    content: bytes


def run_task(task: Task) -> Fit:
    """Simulate and identify; whatever goes wrong is a result."""
    key, seed = task.key, task.seed
    try:
        pair: tuple[AnyScenario, Method] = unpacked(task.content)
        origin, method = pair
        name, _, replication = key
        shown = recorded(origin, replication)
        scenario = scenario_of(origin, seed, shown)
        recording = recording_of(origin, seed, shown)
        model = started(scenario, seed, replication)
        # A label of the user's own moves no number.
        rng = fit_rng(seed, label_of(method), name, replication)
        before = signals_in(recording)
        estimate = identify(method, recording, model, rng)
        if signals_in(recording) != before:
            recording_of.cache_clear()  # the next method has it as it was
            estimate = failed(method.name, model, Outcome.INVALID, "it changed the recording")
        drawn = isinstance(origin, Population)
        ended = Fit(
            *key,
            estimate.outcome.slug,
            estimate.message,
            estimate.outcome.usable,
            number(estimate.vaf),
            int(estimate.iterations),
            number(estimate.seconds),
            estimate.draws is not None,
            excess_of(method, recording, estimate, scenario) if drawn else None,
            told(recording_of(origin, seed, shown), estimate),
            undetermined=tuple(q.key for q in estimate.parameters if not q.determined),
        )
        estimated = {q.key: (q.value, q.std_error, q.lower, q.upper) for q in estimate.parameters}
        return with_truth(ended, scenario, estimated)
    except MemoryError as error:
        return Fit(*key, Outcome.OUT_OF_MEMORY.slug, one_line(str(error)))
    except BaseException as error:  # an interruption too: the user's go to another process
        return Fit(*key, Outcome.CRASHED.slug, one_line(reason(error)))


def with_truth(
    fit: Fit, scenario: Scenario, estimated: Mapping[str, Sequence[float]] | None = None
) -> Fit:
    """A fit with what its recording was drawn from, beside what was estimated, if anything.

    Parameters
    ----------
    fit, scenario
        The fit, and the scenario of its replication.
    estimated
        Value, standard error and ends of the interval of each parameter.

    Raises
    ------
    InputError
        If no bounds can be given, for example because the loop is unstable.
    """
    rows = []
    for known in truths_of(scenario):
        value, error, low, high = map(number, (estimated or {}).get(known[0], (math.nan,) * 4))
        rows.append((*known, value, error, low, high))
    model, facts = scenario.model.name, facts_of(scenario)
    return replace(fit, model=model, facts=facts, estimates=tuple(rows))


def recorded(origin: AnyScenario, replication: int) -> int:
    """Whose recording a replication fits: the first one's, where all fit the same."""
    return 0 if origin.one_recording else replication


@lru_cache(maxsize=2)  # methods of a replication come one after the other
def recording_of(origin: AnyScenario, seed: int, replication: int) -> Recording:
    """The recording of a replication; its signals are read-only."""
    scenario = scenario_of(origin, seed, replication)
    return simulate(scenario, recording_rng(seed, scenario.name, replication))


def excess_of(
    method: Method, recording: Recording, estimate: Estimate, scenario: Scenario
) -> float | None:
    """The criterion of a fit over that of a search by its method which starts at the truth.

    None where the method has no criterion, or where that search fails, which is no fault of
    the fit.
    """
    criteria_from = getattr(method, "criteria_from", None)
    if criteria_from is None or not estimate.outcome.usable:
        return None
    try:
        sets = np.array([estimate.values, scenario.values])
        reached, best = criteria_from(recording, estimate.model, sets)
        return number(reached - best)
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


def given_up(task: Task, loss: Loss, why: str) -> Fit:
    """The row of a fit that gave no estimate at all."""
    return Fit(*task.key, Outcome[loss.name].slug, why)


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
def scenario_of(origin: AnyScenario, seed: int, replication: int) -> Scenario:
    """The scenario of a replication: that which is given, or what a population draws."""
    return origin.drawn(draw_rng(seed, origin.name, replication))


@lru_cache(maxsize=8)
def truths_of(scenario: Scenario) -> tuple[tuple[str, str, float, float | None], ...]:
    """Key, unit, true value and bound (whole record, remnant's spectrum known) of each parameter.

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
    return tuple((p.key, p.unit, float(value), number(float(bound))) for p, value, bound in known)


def facts_of(scenario: Scenario) -> dict[str, str | float]:
    """What was drawn, but for the pilot's parameters: words and numbers."""
    forced = {"target": scenario.target, "disturbance": scenario.disturbance}
    given = [name for name, forcing in forced.items() if forcing is not None]
    return {
        "element": element_kind(scenario.element),
        "forcing": "both" if len(given) == 2 else "".join(given) or "none",
        "remnant": remnant_kind(scenario),
        "remnant_level": scenario.remnant.level,
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
