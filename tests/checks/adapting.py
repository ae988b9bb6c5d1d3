"""Methods on pilots who change, against truth and bound: `nox -s check -- adapting`.

For each scenario and method: bias, scatter and rmse over the bound, coverage, how far `tmid` is
off, and how often a search from the truth finds a better optimum.  `--measured` fits the measured
recordings of pilots who change instead (PILOTID_MEASURED names their folder).
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np

from pilotid.datasets import SCENARIOS, Scenario, simulate
from pilotid.datasets.linearised import bound_of
from pilotid.estimates.estimate import Estimate
from pilotid.estimates.method import Searching, identify
from pilotid.methods import method_named
from pilotid.seeds import fit_rng
from pilotid.types import FloatArray

WITHIN = {"adapting-slow": 1.0, "adapting-fast": 0.3}  # seconds


@dataclass(frozen=True)
class Tried:
    """One recording's estimate."""

    estimate: Estimate
    missed: bool


def tried(scenario: Scenario, method: str, count: int, seed: int) -> list[Tried]:
    """Estimates of simulated recordings."""
    found = []
    estimator = method_named(method)
    for replication in range(count):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(replication,)))
        recording = simulate(scenario, rng)
        fit = identify(estimator, recording, scenario.model, fit_rng(seed + replication, method))
        missed = False
        if isinstance(estimator, Searching) and fit.outcome.usable:
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
        f"{np.median(seconds):.2f} s a fit, "
        f"{sum(t.missed for t in found)} with a better optimum near the truth"
    )
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
    limit = WITHIN["-".join(scenario.name.split("-")[:2])]
    print(
        f"tmid [hundredths of a second in this table]: within {limit:g} s in "
        f"{np.mean(off < limit):.0%}, 95 % within {np.quantile(off, 0.95):.2f} s; "
        f"bound {bound[model.keys.index('tmid')]:.2f} s"
    )


def main() -> None:
    """Run what the options ask for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", nargs="*", default=["adapting-slow", "adapting-fast"])
    parser.add_argument("--method", nargs="*", default=["mle"])
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for name in options.scenario:
        scenario = SCENARIOS[name]
        begin = time.perf_counter()
        bound = bound_of(scenario)
        print(f"bound of {name} in {time.perf_counter() - begin:.1f} s")
        for method in options.method:
            found = tried(scenario, method, options.recordings, options.seed)
            shown(scenario, method, found, bound)


if __name__ == "__main__":
    main()
