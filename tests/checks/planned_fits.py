"""Planned power against experiments that are simulated, fitted by `mle` and tested.

A subject's runs are simulated one by one, each with its own value of the parameter: that of the
condition, the subject's own difference, and what varies from run to run.  The runs of a condition
are fitted together, and the subjects' differences tested as `pilotid analyse` does it.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from pilotid.analysis.combine import plain_mean
from pilotid.datasets import Scenario, simulate
from pilotid.designing.lines import with_held_remnant
from pilotid.designing.planning import LEVEL, Plan
from pilotid.estimates.method import Method, identify
from pilotid.recordings.recording import joined
from pilotid.types import FloatArray, InputError

TRIES = 100  # until values drawn make a stable loop


def planned_fits(
    scenario: Scenario, plan: Plan, subjects: int, runs: int, experiments: int, method: Method
) -> bool:
    """Print planned and simulated power; returns whether they agree within three errors."""
    first = with_held_remnant(replace(scenario, runs=1))
    lost, found, seen = 0, [], []
    start = time.process_time()
    for i in range(experiments):
        rng = np.random.default_rng([i, subjects, runs])
        differences = []
        for _ in range(subjects):
            own = plan.effect + plan.between * rng.standard_normal()
            ends = [_estimate(first, plan, 1.0 + d, runs, method, rng) for d in (0.0, own)]
            if None in ends:
                lost += 1
            else:
                differences.append(ends[1] - ends[0])  # type: ignore[operator]
        seen += differences
        found.append(plain_mean(np.array(differences)).p < LEVEL)
        if (i + 1) % 50 == 0 or i + 1 == experiments:
            agrees = _told(plan, subjects, runs, np.array(found), np.array(seen), lost)
    print(f"CPU {time.process_time() - start:.0f} s", flush=True)
    return agrees


def _estimate(
    scenario: Scenario,
    plan: Plan,
    value: float,
    runs: int,
    method: Method,
    rng: np.random.Generator,
) -> float | None:
    """The parameter from the runs of a subject in a condition, over its true value there."""
    at = scenario.model.keys.index(plan.key)
    recordings = []
    for _ in range(runs):
        for _ in range(TRIES):
            truth = list(scenario.truth)
            truth[at] *= value + plan.within * rng.standard_normal()
            run = replace(scenario, truth=tuple(truth))
            try:
                recordings.append(simulate(run, rng))
                break
            except InputError:  # an unstable loop
                continue
    fit = identify(method, joined(recordings), scenario.model, rng)
    return float(fit.values[at] / scenario.truth[at]) if fit.outcome.usable else None


def _told(
    plan: Plan, subjects: int, runs: int, found: FloatArray, seen: FloatArray, lost: int
) -> bool:
    chance, share, count = plan.chance(subjects, runs), float(found.mean()), found.size
    error = float(np.sqrt(chance * (1.0 - chance) / count))
    spread = float(seen.std(ddof=1))
    print(
        f"{plan.key} {100.0 * plan.effect:+g} %, {subjects} subjects, {runs} runs, {count} "
        f"experiments: planned {chance:.3f}, found {share:.3f} ({(share - chance) / error:+.1f} "
        f"Monte Carlo errors); difference {seen.mean():.3f}, its spread {spread:.3f} +- "
        f"{spread / np.sqrt(2.0 * seen.size):.3f}, planned {plan.deviation(runs):.3f}; {lost} "
        "subjects without an estimate",
        flush=True,
    )
    return abs(share - chance) < 3.0 * error
