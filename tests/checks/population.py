"""Does a method hold on pilots, loops and remnants drawn at random?

    nox -s check -- population --method mle --population population-usual --recordings 200

A table for each method and population: how fits ended, and of those that converged the
errors over the claimed errors (mean, root mean square without the largest 1 %, share beyond
3, worst with its replication) and the coverage of the 95 % intervals, by parameter and by
stratum.  Coverage has its Monte-Carlo error, for which the parameters of one recording count
as one draw.  Scenarios of the catalogue may be named as populations, which are one pilot each.

No method starts at the truth: models have the catalogue's start for a population, and one drawn
from the usual ranges for a scenario, whose truth the catalogue's start may be.  Seeds from 1000
on are for tuning, those below for the final judgement.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np

from pilotid.datasets import Scenario, scenario_named, simulate
from pilotid.datasets.population import POPULATIONS
from pilotid.estimate.estimate import Outcome
from pilotid.estimate.method import identify
from pilotid.methods import method_named
from pilotid.solve.least_squares import draw_starts
from pilotid.support.numbers import fit_rng, recording_rng, start_rng
from pilotid.support.types import BoolArray, FloatArray

TRIMMED = 0.01


@dataclass(frozen=True)
class Result:
    """One fit, with the truth; arrays have the shape (parameters,)."""

    replication: int
    strata: dict[str, str]
    keys: tuple[str, ...]
    outcome: Outcome
    message: str
    seconds: float
    error: FloatArray  # value less truth
    claimed: FloatArray
    covered: BoolArray


def drawn(name: str, seed: int, replication: int) -> Scenario:
    """The replication's scenario; what draws it does not draw its recording."""
    if name in POPULATIONS:
        return POPULATIONS[name].drawn(start_rng(seed, name, replication))
    return scenario_named(name)


def fit(method: str, name: str, seed: int, replication: int) -> Result:
    scenario = drawn(name, seed, replication)
    model = scenario.model
    if name not in POPULATIONS:
        start = draw_starts(model, start_rng(seed, name, replication), 1)[0]
        model = model.with_start(dict(zip(model.keys, start.tolist(), strict=True)))
    recording = simulate(scenario, recording_rng(seed, name, replication))
    rng = fit_rng(seed, method, name, replication)
    estimate = identify(method_named(method), recording, model, rng)
    low, high = estimate.intervals.T
    return Result(
        replication,
        strata(scenario, estimate.std_error / np.abs(scenario.values)),
        model.keys,
        estimate.outcome,
        estimate.message,
        estimate.seconds,
        estimate.values - scenario.values,
        estimate.std_error,
        (low <= scenario.values) & (scenario.values <= high),
    )


def strata(scenario: Scenario, relative: FloatArray) -> dict[str, str]:
    """What a replication is, by kind of stratum."""
    remnant = scenario.remnant
    shape = f"order {remnant.order}" if remnant.shape == "low-pass" else remnant.shape
    if remnant.freedom is not None:
        shape = "Student-t"
    elif remnant.enters != "control":
        shape = f"enters {remnant.enters}"
    forced = {"target": scenario.target, "disturbance": scenario.disturbance}
    level = f"{_class(remnant.level, 0.1, 0.2)}" if remnant.level_is == "ratio" else "gain"
    return {
        "model": scenario.model.name,
        "element": _kind(scenario),
        "dt": f"{scenario.dt:g} s",
        "window": f"{_class(scenario.duration, 45.0, 90.0)} s",
        "run-in": f"{scenario.run_in:.1g} s",
        "runs": str(scenario.runs),
        "forcing": " and ".join(key for key, forcing in forced.items() if forcing is not None),
        "remnant": shape,
        "remnant level": level,
        "remnant frequency": f"{_class(remnant.frequency, 3.0, 6.0)} rad/s",
        "largest claimed": f"{_class(float(np.max(relative)), 0.1, 0.3)} of the truth",
    }


def _class(number: float, low: float, high: float) -> str:
    if number < low:
        return f"below {low:g}"
    return f"{low:g} to {high:g}" if number < high else f"from {high:g}"


def _kind(scenario: Scenario) -> str:
    bottom = np.trim_zeros(np.array(scenario.element.denominator), "f")
    integrators = bottom.size - np.trim_zeros(bottom, "b").size
    return f"order {bottom.size - 1}, {integrators} integrators"


def coverage(results: list[Result]) -> str:
    """Coverage over all parameters, and its Monte-Carlo error."""
    hits = np.array([r.covered.sum() for r in results], dtype=float)
    sizes = np.array([r.covered.size for r in results], dtype=float)
    share = hits.sum() / sizes.sum()
    # Never below that of one miss more or less.
    error = max(np.sqrt(np.sum((hits - share * sizes) ** 2)), 1.0) / sizes.sum()
    return f"{share:.3f} +-{error:.3f} ({len(results)})"


def spread(errors: FloatArray) -> str:
    """Mean, trimmed root mean square, share beyond 3, worst."""
    size = np.sort(np.abs(errors))
    kept = size[: max(1, size.size - round(TRIMMED * size.size))]
    return (
        f"{errors.mean():6.2f} {np.sqrt(np.mean(kept**2)):6.2f} "
        f"{100.0 * np.mean(size > 3.0):6.1f} % {size[-1]:6.1f}"
    )


def show(results: list[Result]) -> None:
    counts = Counter(r.outcome for r in results)
    for outcome, count in counts.most_common():
        print(f"{100.0 * count / len(results):5.1f} %  {outcome.value}")
        messages = Counter(
            re.sub(r"[\d.]+(e[+-]\d+)?", "#", r.message) for r in results if r.outcome is outcome
        )
        for message, times in messages.most_common(6):
            if message and outcome is not Outcome.CONVERGED:
                print(f"           {times} x {message}")
    seconds = np.array([r.seconds for r in results])
    if np.isfinite(seconds).any():
        low, high = np.nanquantile(seconds, [0.5, 0.95])
        print(f"{1e3 * low:.0f} ms in the middle, {1e3 * high:.0f} ms or more in one of twenty")
    bounded = [r for r in results if r.outcome is Outcome.AT_BOUND]
    if bounded:
        print(f"coverage of those at a bound {coverage(bounded)}")
    used = [r for r in results if r.outcome is Outcome.CONVERGED]
    if not used:
        return
    print(f"coverage of the converged {coverage(used)}\n")
    print("             coverage  error over claimed error:  mean    rms  beyond 3  worst  at")
    keys = dict.fromkeys(key for r in used for key in r.keys)
    for key in keys:
        rows = [(r, r.keys.index(key)) for r in used if key in r.keys]
        z = np.array([r.error[i] / r.claimed[i] for r, i in rows])
        share = np.mean([r.covered[i] for r, i in rows])
        worst = rows[int(np.argmax(np.abs(z)))][0].replication
        error = max(np.sqrt(share * (1.0 - share) * z.size), 1.0) / z.size
        print(f"{key:8} {share:.3f} +-{error:.3f} ({z.size}){spread(z):>44}  {worst}")
    every = np.concatenate([r.error / r.claimed for r in used])
    print(f"{'all':8} {'':20}{spread(every):>44}\n")
    for kind in used[0].strata:
        values = sorted({r.strata[kind] for r in used})
        parts = [f"{v}: {coverage([r for r in used if r.strata[kind] == v])}" for v in values]
        print(f"{kind}: {'; '.join(parts)}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--method", action="append", required=True)
    parser.add_argument("--population", action="append", help="or a scenario; all if left out")
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    count = given.recordings
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        for name in given.population or POPULATIONS:
            for method in given.method:
                jobs = ([method] * count, [name] * count, [given.seed] * count, range(count))
                results = list(pool.map(fit, *jobs, chunksize=4))
                print(f"\n{method} on {name}, seed {given.seed}, {count} recordings", flush=True)
                show(results)


if __name__ == "__main__":
    main()
