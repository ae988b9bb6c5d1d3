"""How well maximum likelihood can do at all on pilots who change.

`nox -s check -- adapting-oracle`: beside `mle` the same with the remnant's true spectrum as
whitening filter, searched as ever and from the truth as well; whichever is likelier is the maximum
of the likelihood itself, and what lies between it and the bound no search and no model of the
remnant mends.  `--quieter 10` asks the same with a remnant of a tenth of the power, where the bound
must be reached.  With `--ratio tmid` the last columns say what coverage an interval could have: how
often the likelihood ratio of the true value, all others sought anew from several changes, stays
within the level that `mle` goes to, and its 95 % quantile, which chi-squared puts at 3.84.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from pilotid.chance import CHI_SQUARED_95
from pilotid.datasets import SCENARIOS, Scenario, simulate
from pilotid.datasets.experiments import bound_of
from pilotid.datasets.remnant import UNIT_LEVEL
from pilotid.datasets.simulation import white_level
from pilotid.estimates.estimate import Estimate
from pilotid.estimates.method import identify
from pilotid.methods.mle import MLE
from pilotid.seeds import fit_rng
from pilotid.solve.least_squares import Box, minimise
from pilotid.time_domain.optimum import Optimum
from pilotid.time_domain.prepare import Band
from pilotid.time_domain.remnant_models import LowPass
from pilotid.time_domain.search import maxima_from
from pilotid.types import BoolArray, FloatArray

#: Changes from which the likelihood at a true value is sought: seconds from the best one's
#: middle, and rates [1/s].
SHIFTS, RATES = (-3.0, 0.0, 3.0), (0.4, 2.0, 30.0)


@dataclass(frozen=True)
class KnownRemnant:
    """A remnant's spectrum that is known: a low-pass filter without free parameters."""

    order: int
    values: tuple[float, ...]
    name: ClassVar[str] = "known"
    regressive: ClassVar[bool] = False
    keys: ClassVar[tuple[str, ...]] = ()

    @property
    def lower(self) -> FloatArray:
        return np.zeros(0)

    @property
    def upper(self) -> FloatArray:
        return np.zeros(0)

    @property
    def positive(self) -> BoolArray:
        return np.zeros(0, dtype=bool)

    def taps(self, values: FloatArray, band: Band) -> tuple[FloatArray, FloatArray]:
        taps = LowPass(self.order).taps(np.array([self.values]), band)[0]
        return np.repeat(taps, len(values), axis=0), np.zeros((len(values), 0, taps.shape[1]))

    def filters(self, values: FloatArray, band: Band) -> FloatArray:
        return self.taps(values, band)[0]

    def guess(self, products: FloatArray, band: Band) -> FloatArray:
        return np.zeros(0)

    def power(
        self, omega: FloatArray, values: FloatArray
    ) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        """See `LowPass.power`; remnants of estimates are drawn by it."""
        power = LowPass(self.order).power(omega, np.array([self.values]))[0]
        return np.repeat(power, len(values), axis=0), ()


@dataclass(frozen=True)
class Tried:
    """What was found of one recording."""

    estimate: Estimate
    from_truth: Optimum
    likelier: FloatArray
    ratios: FloatArray


def oracle_of(scenario: Scenario) -> MLE:
    """`mle` with the scenario's remnant."""
    remnant = scenario.remnant
    if remnant.shape != "low-pass" or remnant.order > 1:
        raise ValueError("the scenario's remnant must be white or of first order")
    return MLE(noise=KnownRemnant(remnant.order, (remnant.frequency,)[: remnant.order]))


def quieter(scenario: Scenario, by: float) -> Scenario:
    """The scenario with less power of the white noise that drives its remnant."""
    gain = white_level(scenario) / UNIT_LEVEL / np.sqrt(by)
    remnant = replace(scenario.remnant, level_is="gain", level=float(gain))
    return replace(scenario, name=f"{scenario.name}-quieter", remnant=remnant)


def ratios_at_truth(
    found: Optimum, best: FloatArray, truth: FloatArray, keys: tuple[str, ...]
) -> FloatArray:
    """Likelihood ratios of the true values, one parameter at a time, shape (parameters,).

    Parameters
    ----------
    found
        An optimum, for its problem: remnant and band.
    best
        The likeliest pilot known, shape (parameters,).
    truth
        The true parameters.
    keys
        Parameters that are asked for; of all others it is NaN.
    """
    joint, own = found.joint, found.end.values[0]
    ((middle, rate),) = joint.prediction.model.whens
    if not keys:
        return np.full(len(truth), np.nan)
    bases = [np.concatenate([pilot, own[joint.pilot :]]) for pilot in (best, truth, found.pilot)]
    lowest = float(minimise(joint.gram, np.array(bases), joint, tolerance=1e-5).cost[0])
    freedom = joint.residuals - len(own)
    result = np.full(len(truth), np.nan)
    for which in map(joint.prediction.model.keys.index, keys):
        value = truth[which]
        starts = list(bases)
        for shift in SHIFTS:
            for speed in RATES:
                starts.append(bases[0].copy())
                starts[-1][middle] += shift
                starts[-1][rate] = speed
        held = Box.holding(joint, which, value)
        points = np.clip(starts, held.lower, held.upper)
        cost = minimise(joint.gram, points, held, tolerance=1e-4, iterations=15).cost[0]
        result[which] = freedom * np.log(cost / lowest) / found.variance_factor
    return result


def tried(
    scenario: Scenario, method: MLE, count: int, seed: int, keys: tuple[str, ...]
) -> list[Tried]:
    """Estimates of simulated recordings, and the maxima that the truth leads to."""
    found = []
    for replication in range(count):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(replication,)))
        recording = simulate(scenario, rng)
        fit = identify(method, recording, scenario.model, fit_rng(seed + replication, "mle"))
        near = maxima_from(recording, scenario.model, method, scenario.values[None])[0]
        better = not fit.outcome.usable or near.criterion < fit.criterion
        best = near.pilot if better else fit.values
        ratios = ratios_at_truth(near, best, scenario.values, keys)
        found.append(Tried(fit, near, best, ratios))
    return found


def shown(scenario: Scenario, name: str, found: list[Tried]) -> None:
    """Print a table."""
    truth, bound = scenario.values, bound_of(scenario)
    usable = [t.estimate for t in found if t.estimate.outcome.usable]
    missed = sum(t.from_truth.criterion < t.estimate.criterion - 0.5 for t in found)
    print(
        f"\n{scenario.name}, {name}: {len(usable)} of {len(found)} usable, {missed} searches "
        "missed what the truth leads to\n"
        "parameter   bias %  +- %  rmse/bound  +-  likeliest  near the truth  log scale  "
        "central 68 %  coverage  within ratio  its 95 %"
    )
    values = np.array([e.values for e in usable])
    likelier = np.array([t.likelier for t in found])
    near = np.array([t.from_truth.pilot for t in found])
    inside = np.array([(e.intervals[:, 0] <= truth) & (truth <= e.intervals[:, 1]) for e in usable])
    ratios = np.array([t.ratios for t in found])
    within = np.where(np.isnan(ratios), np.nan, ratios <= CHI_SQUARED_95)
    for i, parameter in enumerate(scenario.model.parameters):
        off = (values[:, i] - truth[i]) / bound[i]
        whole = 0.01 if parameter.key == "tmid" else truth[i] / 100.0
        rmse = np.sqrt(np.mean(off**2))
        error = np.std(off**2) / np.sqrt(len(off)) / (2.0 * rmse)
        logs = np.log(values[:, i] / truth[i]) * truth[i] / bound[i]
        print(
            f"{parameter.key:<9}{np.mean(off) * bound[i] / whole:>9.1f}"
            f"{np.std(off) / np.sqrt(len(off)) * bound[i] / whole:>6.1f}{rmse:>12.2f}{error:>5.2f}"
            f"{_rms((likelier[:, i] - truth[i]) / bound[i]):>9.2f}"
            f"{_rms((near[:, i] - truth[i]) / bound[i]):>14.2f}{_rms(logs):>13.2f}"
            f"{np.quantile(np.abs(off), 0.6827):>12.2f}{np.mean(inside[:, i]):>13.3f}"
            f"{np.mean(within[:, i]):>12.3f}{np.quantile(ratios[:, i], 0.95):>12.2f}"
        )


def _rms(off: FloatArray) -> float:
    return float(np.sqrt(np.mean(off**2)))


def main() -> None:
    """Run what the options ask for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", nargs="*", default=["adapting-slow", "adapting-fast"])
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--quieter", type=float, default=1.0, help="divides the remnant's power")
    parser.add_argument("--ratio", nargs="*", default=[], help="parameters whose ratios to find")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--alone", action="store_true", help="without mle itself")
    options = parser.parse_args()
    for name in options.scenario:
        scenario = SCENARIOS[name]
        if options.quieter != 1.0:
            scenario = quieter(scenario, options.quieter)
        methods = {"known remnant": oracle_of(scenario), "mle": MLE()}
        for label, method in list(methods.items())[: 1 if options.alone else 2]:
            found = tried(scenario, method, options.recordings, options.seed, tuple(options.ratio))
            shown(scenario, label, found)


if __name__ == "__main__":
    main()
