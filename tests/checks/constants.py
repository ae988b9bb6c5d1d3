"""The two constants of `mle` that come from simulation: its wide band, and short recordings.

    nox -s check -- constants ratio [--recordings 200] [--seed 1000]
    nox -s check -- constants band [--pilots 8] [--seed 1000]

``ratio``: twice the log-likelihood ratio of the truth over its number of parameters, which
chi-squared puts at 1, on pilots drawn at random; values outside 0 to 4 count as these, so that
a wrong optimum does not decide the mean.  ``band``: bias of pilots in position control over 40 runs
fitted jointly, by analysis band; the search starts at the truth and the remnant's family is
given, so that nothing but the band differs.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from pilotid.datasets import simulate
from pilotid.datasets.population import POPULATIONS
from pilotid.methods.mle import MLE
from pilotid.solve.least_squares import minimise
from pilotid.support.numbers import fit_rng, recording_rng, start_rng
from pilotid.support.types import BoolArray, FloatArray
from pilotid.time_domain.likelihood import PredictionErrors
from pilotid.time_domain.prediction import predict
from pilotid.time_domain.prepare import analysis_band
from pilotid.time_domain.remnant_models import LowPass
from pilotid.time_domain.search import maximise_likelihood
from pilotid.time_domain.settings import PROFILE


class RemnantAlone:
    """The remnant's parameters beside a pilot that is given."""

    def __init__(self, joint: PredictionErrors, pilot: FloatArray) -> None:
        self.joint, self.pilot = joint, pilot
        self.lower: FloatArray = joint.noise.lower
        self.upper: FloatArray = joint.noise.upper
        self.positive: BoolArray = joint.noise.positive

    def gram(self, values: FloatArray) -> FloatArray:
        pilots = np.tile(self.pilot, (len(values), 1))
        grams = self.joint.gram(np.hstack([pilots, values]))
        return grams[:, self.joint.pilot :, self.joint.pilot :]


def ratio(name: str, recordings: int, seed: int) -> None:
    found = []
    for replication in range(recordings):
        scenario = POPULATIONS[name].drawn(start_rng(seed, name, replication))
        recording = simulate(scenario, recording_rng(seed, name, replication))
        rng = fit_rng(seed, "mle", name, replication)
        best = maximise_likelihood(recording, scenario.model, rng, MLE())
        alone = RemnantAlone(best.joint, scenario.values)
        own = best.end.values[:1, best.joint.pilot :]
        cost = minimise(alone.gram, own, alone, tolerance=1e-7).cost[0] if own.size else None
        if cost is None:
            cost = alone.gram(own)[0, -1, -1]
        deviance = best.joint.residuals * np.log(cost / best.end.cost[0])
        seconds = best.joint.prediction.runs * best.joint.prediction.scored
        found.append((deviance / best.joint.pilot, seconds * best.joint.prediction.dt))
    ratios, seconds = np.array(found).T
    ratios = np.clip(ratios, 0.0, 4.0)
    error = np.std(ratios) / np.sqrt(recordings)
    print(
        f"{name}: likelihood ratio over chi-squared {np.mean(ratios):.3f} +- {error:.3f}, "
        f"allowed for {np.mean(1.0 + PROFILE.bartlett_seconds / seconds):.3f} "
        f"({recordings} recordings)"
    )


def band(pilots: int, seed: int) -> None:
    name = "population-usual"
    population = replace(POPULATIONS[name], models=("lead-lag",), runs=(40,))
    replication = done = 0
    while done < pilots:
        replication += 1
        scenario = population.drawn(start_rng(seed, name, replication))
        if len(scenario.element.denominator) > 1:
            continue
        done += 1
        recording = simulate(scenario, recording_rng(seed, name, replication))
        for rate in (50.0, 120.0, 300.0):
            noise = LowPass(scenario.remnant.order)
            analysis = analysis_band(scenario.dt, rate)
            joint = PredictionErrors(
                replace(predict(recording, scenario.model, rate), terms=()), noise, analysis
            )
            remnant = [scenario.remnant.frequency, scenario.remnant.damping][: len(noise.keys)]
            end = minimise(joint.gram, np.array([[*scenario.values, *remnant]]), joint)
            bias = 100.0 * (end.values[0, : joint.pilot] / scenario.values - 1.0)
            told = ", ".join(
                f"{key} {b:+.1f}" for key, b in zip(scenario.model.keys, bias, strict=True)
            )
            print(f"pilot {done}, {1.0 / scenario.dt:.0f} Hz, {rate:.0f} rad/s: bias [%] {told}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["ratio", "band"])
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--pilots", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1000)
    asked = parser.parse_args()
    if asked.what == "band":
        band(asked.pilots, asked.seed)
        return
    for name in ("population-short", "population-usual"):
        ratio(name, asked.recordings, asked.seed)


if __name__ == "__main__":
    main()
