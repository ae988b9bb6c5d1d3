"""Methods on pilots who change, against truth and bound: `nox -s check -- adapting`.

For each scenario and method: bias, scatter and rmse over the bound, coverage, how far `tmid` is
off, with `--search` how often a search from the truth finds a better optimum, and of several
methods how far they are from the first.
`--measured` fits recordings of pilots who change, all runs of a condition jointly, with a constant
and with a changing model (PILOTID_MEASURED names the folder above them).
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from pilotid.datasets import SCENARIOS, Scenario, simulate
from pilotid.datasets.experiments import bound_of
from pilotid.estimates.estimate import Estimate
from pilotid.estimates.method import Searching, identify
from pilotid.methods import method_named
from pilotid.pilot.catalogue import ADAPTING, SINGLE
from pilotid.recordings.files import load_recording
from pilotid.support.numbers import fit_rng
from pilotid.support.types import FloatArray

#: Conditions of the experiment in which the element changes, and in which axes.
CHANGED = {
    "C3": ("roll",),
    "C4": ("pitch",),
    "C5": ("roll", "pitch"),
    "C6": ("roll",),
    "C7": ("pitch",),
    "C8": ("roll", "pitch"),
}
WITHIN = {"adapting-slow": 1.0, "adapting-fast": 0.3}  # seconds


@dataclass(frozen=True)
class Tried:
    """One recording's estimate."""

    estimate: Estimate
    missed: bool


def tried(scenario: Scenario, method: str, count: int, seed: int, *, search: bool) -> list[Tried]:
    """Estimates of simulated recordings, and whether their searches missed a better optimum."""
    found = []
    estimator = method_named(method)
    for replication in range(count):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(replication,)))
        recording = simulate(scenario, rng)
        fit = identify(estimator, recording, scenario.model, fit_rng(seed + replication, method))
        missed = False
        if search and isinstance(estimator, Searching) and fit.outcome.usable:
            sets = np.array([fit.values, scenario.values])
            own, other = estimator.criteria_from(recording, scenario.model, sets)
            missed = bool(other < own - 0.5)
        found.append(Tried(fit, missed))
    return found


def shown(scenario: Scenario, method: str, found: list[Tried], bound: FloatArray) -> None:
    """Print the table of a scenario and a method."""
    model, truth = scenario.model, scenario.values
    usable = [t.estimate for t in found if t.estimate.outcome.usable]
    seconds = np.array([t.estimate.seconds for t in found])
    print(
        f"\n{scenario.name}, {method}: {len(usable)} of {len(found)} usable, "
        f"{np.median(seconds):.2f} s a fit, {sum(t.missed for t in found)} searches missed"
    )
    if not usable:
        return
    values = np.array([e.values for e in usable])
    inside = np.array([(e.intervals[:, 0] <= truth) & (truth <= e.intervals[:, 1]) for e in usable])
    print("parameter  truth    median   bias %  +- %   scatter %  rmse/bound  coverage")
    for i, parameter in enumerate(model.parameters):
        off = values[:, i] - truth[i]
        error = np.std(off) / np.sqrt(len(off))
        rmse = np.sqrt(np.mean(off**2))
        # A time is judged in seconds, not as a share of when the run began.
        whole = 0.01 if parameter.key == "tmid" else truth[i] / 100.0
        print(
            f"{parameter.key:<9}{truth[i]:>8.4g}{np.median(values[:, i]):>10.4g}"
            f"{np.mean(off) / whole:>9.1f}{error / whole:>7.1f}{np.std(off) / whole:>10.1f}"
            f"{rmse / bound[i]:>12.2f}{np.mean(inside[:, i]):>11.3f}"
        )
    off = np.abs(values[:, model.keys.index("tmid")] - truth[model.keys.index("tmid")])
    limit = WITHIN[scenario.name]
    print(
        f"tmid [hundredths of a second in this table]: within {limit:g} s in "
        f"{np.mean(off < limit):.0%}, 95 % within {np.quantile(off, 0.95):.2f} s; "
        f"bound {bound[model.keys.index('tmid')]:.2f} s"
    )


def compared(scenario: Scenario, names: tuple[str, str], fits: list[list[Tried]]) -> None:
    """Print how far the second method's values and intervals are from the first one's."""
    pairs = [(a.estimate, b.estimate) for a, b in zip(*fits, strict=True)]
    both = [(a, b) for a, b in pairs if a.outcome.usable and b.outcome.usable]
    print(
        f"\n{scenario.name}, {names[1]} less {names[0]}, of {len(both)} recordings, in the "
        f"standard errors of {names[0]}\n"
        "parameter   median  median size  95 % within  length of intervals  true in both, one, none"
    )
    for i, parameter in enumerate(scenario.model.parameters):
        off = np.array([(b.values[i] - a.values[i]) / a.std_error[i] for a, b in both])
        length = [np.ptp(b.intervals[i]) / np.ptp(a.intervals[i]) for a, b in both]
        truth = scenario.values[i]
        held = np.array(
            [[e.intervals[i, 0] <= truth <= e.intervals[i, 1] for e in pair] for pair in both]
        )
        counts = np.bincount(held.sum(axis=1), minlength=3)
        print(
            f"{parameter.key:<9}{np.median(off):>9.2f}{np.median(np.abs(off)):>13.2f}"
            f"{np.quantile(np.abs(off), 0.95):>13.2f}{np.median(length):>21.2f}"
            f"{counts[2]:>13} {counts[1]} {counts[0]}"
        )


def measured(subjects: list[str], named: str) -> None:
    """Fit pilots of whom the element changed, a line for each subject, condition and axis."""
    folder = Path(os.environ["PILOTID_MEASURED"]) / "adaptation"
    subjects = subjects or sorted({path.name.split("_")[0] for path in folder.glob("*.mat")})
    method = method_named(named)
    print("file, model: outcome, s, VAF %, parameters, standard errors")
    gained: dict[str, list[FloatArray]] = {}
    for subject, condition, axis in product(subjects, CHANGED, ("roll", "pitch")):
        recording = load_recording(folder / f"{subject}_{condition}_{axis}.mat")
        fits = [
            identify(method, recording, model, fit_rng(1, model.name))
            for model in (SINGLE, ADAPTING)
        ]
        for fit in fits:
            pairs = zip(fit.values, fit.std_error, strict=True)
            values = " ".join(f"{value:.3g}+-{error:.2g}" for value, error in pairs)
            print(
                f"{subject} {condition} {axis}, {fit.model.name}: {fit.outcome.slug}, "
                f"{fit.seconds:.1f}, {fit.vaf:.1f}, {values}",
                flush=True,
            )
        constant, changing = fits
        kind = "changes" if axis in CHANGED[condition] else "stays"
        row = [
            float(changing.outcome.usable),
            changing.vaf - constant.vaf,
            changing.values[1] / changing.values[0],
            changing.values[3] / changing.values[2],
            changing.values[4],
            changing.values[5],
            constant.criterion - changing.criterion,
            changing.seconds,
        ]
        gained.setdefault(f"{axis} {kind}", []).append(np.array(row))
    print("axis: files, usable, gain of VAF, Kvis2 < Kvis1, tlead2 > tlead1, median tmid, seconds")
    for what, rows in sorted(gained.items()):
        usable, vaf, gain, lead, middle, _, _, seconds = np.array(rows).T
        print(
            f"{what}: {len(rows)}, {usable.mean():.0%}, {np.nanmean(vaf):.1f} %, "
            f"{np.mean(gain < 1.0):.0%}, {np.mean(lead > 1.0):.0%}, {np.nanmedian(middle):.1f} s, "
            f"{np.median(seconds):.1f} s, at most {np.max(seconds):.0f} s"
        )


def main() -> None:
    """Run what the options ask for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", nargs="*", default=["adapting-slow", "adapting-fast"])
    parser.add_argument("--method", nargs="*", default=["mle"])
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--search", action="store_true", help="search from the truth as well")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--measured", nargs="*", help="subjects, for example pilot2; none for all")
    options = parser.parse_args()
    if options.measured is not None:
        measured(options.measured, options.method[0])
        return
    for name in options.scenario:
        scenario = SCENARIOS[name]
        begin = time.perf_counter()
        bound = bound_of(scenario)
        print(f"bound of {name} in {time.perf_counter() - begin:.1f} s")
        first: list[Tried] = []
        for method in options.method:
            found = tried(scenario, method, options.recordings, options.seed, search=options.search)
            shown(scenario, method, found, bound)
            first = first or found
            if first is not found:
                compared(scenario, (options.method[0], method), [first, found])


if __name__ == "__main__":
    main()
