"""Does `mle` reach the best optimum from starts anywhere inside the bounds?

    nox -s check -- optima --replications 500

For every recording the likelihood at the estimate is compared with the best one known:
that of the estimate itself and that reached from the truth.
"""

from __future__ import annotations

import argparse
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np

from pilotid.datasets import SCENARIOS, Scenario, simulate
from pilotid.estimates.method import identify
from pilotid.methods.mle import MLE
from pilotid.solve.least_squares import minimise
from pilotid.support.types import FloatArray
from pilotid.time_domain.likelihood import PredictionErrors
from pilotid.time_domain.prediction import predict
from pilotid.time_domain.prepare import analysis_band
from pilotid.time_domain.remnant_models import LowPass

SAME = 0.5  # units of the deviance


def scenarios() -> dict[str, Scenario]:
    """The nominal scenario, and one whose remnant resonates at the neuromuscular frequency."""
    nominal = SCENARIOS["nominal"]
    resonant = replace(nominal.remnant, frequency=12.7, damping=0.26, level=0.15, level_is="ratio")
    return {"nominal": nominal, "resonant remnant": replace(nominal, remnant=resonant)}


def random_start(scenario: Scenario, rng: np.random.Generator) -> dict[str, float]:
    """Anywhere inside the bounds: positive parameters by their logarithm."""
    model = scenario.model
    share = rng.uniform(0.001, 0.999, len(model.parameters))
    plain = model.lower + share * (model.upper - model.lower)
    low = np.where(model.positive, model.lower, 1.0)
    drawn = np.where(model.positive, low * (model.upper / low) ** share, plain)
    return dict(zip(model.keys, drawn.tolist(), strict=True))


def deviance(name: str, replication: int) -> tuple[str, float]:
    """Outcome of one fit, and how far its likelihood stays behind the best one known."""
    scenario = scenarios()[name]
    rng = np.random.default_rng([replication, 1])
    recording = simulate(scenario, np.random.default_rng(replication))
    method = MLE()
    model = scenario.model.with_start(random_start(scenario, rng))
    estimate = identify(method, recording, model, rng)
    if not estimate.outcome.usable:
        return estimate.outcome.value, float("inf")
    band = analysis_band(recording.dt, method.band)
    prediction = replace(predict(recording, scenario.model, method.band), terms=())
    joint = PredictionErrors(prediction, LowPass(2), band)
    remnant = np.array([scenario.remnant.frequency, scenario.remnant.damping])

    def cost(values: FloatArray) -> float:
        start = np.concatenate([values, remnant])[None]
        return float(minimise(joint.gram, start, joint, tolerance=1e-7).cost[0])

    reached, from_truth = cost(estimate.values), cost(scenario.values)
    return estimate.outcome.value, joint.residuals * float(
        np.log(reached / min(reached, from_truth))
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--replications", type=int, default=500)
    parser.add_argument("--workers", type=int, default=2)
    settings = parser.parse_args()
    with ProcessPoolExecutor(settings.workers, mp_context=get_context("spawn")) as pool:
        for name in scenarios():
            count = settings.replications
            results = list(pool.map(deviance, [name] * count, range(count), chunksize=10))
            missed = [i for i, (_, d) in enumerate(results) if d > SAME]
            outcomes = Counter(outcome for outcome, _ in results)
            print(
                f"{name}: {count - len(missed)} of {count} in the best optimum known; "
                f"outcomes {dict(outcomes)}; missed {missed}"
            )


if __name__ == "__main__":
    main()
