"""The course of parameters over time against truth: `nox -s check -- courses`.

For each scenario and method: root mean square errors of the trajectory before, during and after
the change, how often its 95 % band holds the truth, bias and coverage of delay and neuromuscular
parameters, when it passes half of the change of the lead, and how fits ended.  `--measured` fits
recordings of pilots who change, all runs of a condition jointly (PILOTID_MEASURED names the
folder).
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from itertools import product
from pathlib import Path

import numpy as np

from pilotid.datasets import SCENARIOS, Scenario, simulate
from pilotid.estimates.estimate import Estimate
from pilotid.estimates.method import identify
from pilotid.methods import method_named
from pilotid.pilot.catalogue import ADAPTING
from pilotid.pilot.frozen import frozen, frozen_over
from pilotid.recordings.files import load_recording
from pilotid.seeds import fit_rng
from pilotid.types import FloatArray

#: Seconds around the middle of the change that count as during it.
DURING = 6.0
CONDITIONS = ("C3", "C4", "C5", "C6", "C7", "C8")


def fits(scenario: Scenario, method: str, count: int, seed: int) -> list[Estimate]:
    """Estimates of simulated recordings."""
    estimator, found = method_named(method), []
    for replication in range(count):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(replication,)))
        recording = simulate(scenario, rng)
        found.append(
            identify(estimator, recording, scenario.model, fit_rng(seed + replication, method))
        )
    return found


def shown(scenario: Scenario, method: str, found: list[Estimate]) -> None:
    """Print what the trajectories of a scenario and a method are worth."""
    ends = Counter(e.outcome.slug for e in found)
    seconds = np.median([e.seconds for e in found])
    print(f"\n{scenario.name}, {method}: {dict(ends)}, {seconds:.1f} s a fit")
    keys, truth = scenario.model.keys, scenario.values
    middle = truth[keys.index("tmid")] if "tmid" in keys else 41.0
    errors: list[FloatArray] = []
    inside: list[FloatArray] = []
    passed = []
    for estimate in found:
        course = estimate.trajectory
        if course is None or not estimate.outcome.usable:
            continue
        true = frozen_over(scenario.model, truth, course.time)
        known = np.isfinite(course.values).all(axis=0)
        held = (course.lower <= true) & (true <= course.upper)
        away = course.time - middle
        parts = (away < -DURING, np.abs(away) <= DURING, away > DURING)
        errors.append(
            np.array(
                [np.mean((course.values - true)[:, known & part] ** 2, axis=1) for part in parts]
            )
        )
        inside.append(np.array([held[:, known & part].mean(axis=1) for part in parts]))
        lead = course.values[1] if len(course.keys) > 1 else course.values[0]
        half = 0.5 * (true[1, 0] + true[1, -1]) if len(course.keys) > 1 else np.nan
        crossed = np.flatnonzero(known & (lead > half))
        passed.append(course.time[crossed[0]] - middle if crossed.size else np.nan)
    if not errors:
        return
    names = frozen(scenario.model).keys
    rmse = np.sqrt(np.mean(errors, axis=0))
    spread = np.std(np.sqrt(errors), axis=0) / np.sqrt(len(errors))
    cover = np.mean(inside, axis=0)
    print("trajectory: rmse before, during and after the change, and coverage of its band there")
    for i, name in enumerate(names):
        parts_shown = "".join(
            f"{r:>10.4f} +- {s:.4f}" for r, s in zip(rmse[:, i], spread[:, i], strict=True)
        )
        covers = " ".join(f"{c:.2f}" for c in cover[:, i])
        print(f"{name:<8}{parts_shown}   {covers}")
    print(f"lead passes its half {np.nanmedian(passed):+.2f} s after the truth (median)")
    usable = [e for e in found if e.outcome.usable]
    for key in names:
        if key not in keys:
            continue
        i = keys.index(key)
        off = np.array([e.values[i] for e in usable]) / truth[i] - 1.0
        held = [e.intervals[i, 0] <= truth[i] <= e.intervals[i, 1] for e in usable]
        print(
            f"{key}: bias {100 * off.mean():+.1f} +- {100 * off.std() / np.sqrt(len(off)):.1f} %, "
            f"scatter {100 * off.std():.1f} %, coverage {np.mean(held):.2f}"
        )


def measured(subjects: list[str], methods: list[str]) -> None:
    """Fit pilots of whom the element changed, a line for each file and method."""
    folder = Path(os.environ["PILOTID_MEASURED"]) / "adaptation"
    print("file, method: outcome, s, VAF %, parameters, standard errors")
    for subject, condition, axis in product(subjects, CONDITIONS, ("roll", "pitch")):
        recording = load_recording(folder / f"{subject}_{condition}_{axis}.mat")
        for method in methods:
            fit = identify(method_named(method), recording, ADAPTING, fit_rng(1, method))
            pairs = zip(fit.values, fit.std_error, strict=True)
            values = " ".join(f"{value:.3g}+-{error:.2g}" for value, error in pairs)
            print(
                f"{subject} {condition} {axis}, {method}: {fit.outcome.slug}, {fit.seconds:.1f}, "
                f"{fit.vaf:.1f}, {values}",
                flush=True,
            )


def main() -> None:
    """Run what the options ask for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", nargs="*", default=["adapting-slow", "adapting-fast"])
    parser.add_argument("--method", nargs="*", default=["ukf"])
    parser.add_argument("--recordings", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--measured", nargs="+", help="subjects, for example pilot2")
    options = parser.parse_args()
    if options.measured:
        measured(options.measured, options.method)
        return
    for name in options.scenario:
        for method in options.method:
            found = fits(SCENARIOS[name], method, options.recordings, options.seed)
            shown(SCENARIOS[name], method, found)


if __name__ == "__main__":
    main()
