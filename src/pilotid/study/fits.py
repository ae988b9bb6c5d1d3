"""One fit of a study: what crosses to another process, and the row that comes back."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pilotid.datasets import Scenario, simulate
from pilotid.estimates.estimate import Estimate, Outcome
from pilotid.estimates.method import Method, identify
from pilotid.estimates.sound import one_line
from pilotid.naming.code import reason, unpacked
from pilotid.pilot.model import PilotModel
from pilotid.seeds import fit_rng, recording_rng, start_rng
from pilotid.study.entries import Result, Unit
from pilotid.study.process import Loss

LOST = {Loss.DIED: Outcome.DIED, Loss.TIMED_OUT: Outcome.TIMED_OUT}

#: Outcomes that another try may mend; an error that the code makes comes again.
OUTSIDE = (Outcome.CRASHED, Outcome.OUT_OF_MEMORY, Outcome.TIMED_OUT, Outcome.DIED)


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
    try:
        held: tuple[Scenario, Method] = unpacked(task.content)
        scenario, method = held
        replication = 0 if scenario.one_recording else unit.replication
        recording = simulate(scenario, recording_rng(seed, scenario.name, replication))
        model = started(scenario, seed, unit.replication)
        rng = fit_rng(seed, unit.method, unit.scenario, unit.replication)
        return _result(unit, identify(method, recording, model, rng))
    except MemoryError as error:
        return Result(unit, Outcome.OUT_OF_MEMORY.slug, one_line(str(error)))
    except BaseException as error:  # an interruption too: the user's go to another process
        return Result(unit, Outcome.CRASHED.slug, one_line(reason(error)))


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
    return Result(task.unit, LOST[loss].slug, why)


def _result(unit: Unit, estimate: Estimate) -> Result:
    return Result(
        unit,
        estimate.outcome.slug,
        estimate.message,
        estimate.outcome.usable,
        number(estimate.vaf),
        int(estimate.iterations),
        estimate.draws is not None,
        number(estimate.seconds),
        tuple(
            (q.key, number(q.value), number(q.std_error), number(q.lower), number(q.upper))
            for q in estimate.parameters
        ),
    )


def number(value: float) -> float | None:
    """A number for the store, None where it is none."""
    return float(value) if math.isfinite(value) else None
