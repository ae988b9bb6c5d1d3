"""The samplers of `bayes` against one another, and how long each takes.

    nox -s check -- samplers --recordings 5

Importance sampling and emcee at full size on recordings of `nominal`, emcee with moves by
differential evolution alone, so that the two have nothing in common but the posterior.  The
spreads are compared on the scale of sampling.  Exit status 1 if, over all recordings, a
spread differs by 3 % or more, or if a full emcee run takes 15 s, or the fast path 0.3 s.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np

from pilotid.datasets import SCENARIOS, simulate
from pilotid.estimates.draws import Draws
from pilotid.estimates.estimate import Estimate
from pilotid.estimates.method import identify
from pilotid.methods.bayes import Bayes
from pilotid.support.numbers import fit_rng, recording_rng
from pilotid.support.types import FloatArray

NOMINAL = SCENARIOS["nominal"]
METHOD = Bayes()
LARGE = {
    "importance": replace(METHOD, sampler="importance", draws=60_000),
    "emcee": replace(
        METHOD,
        sampler="emcee",
        run=replace(METHOD.run, most=20_000, effective=10_000.0, independent=0.0),
    ),
}
USUAL = {"fast path": METHOD, "emcee": replace(METHOD, sampler="emcee")}
LIMITS = {"fast path": 0.3, "emcee": 15.0}


def fit(method: Bayes, number: int, seed: int) -> Estimate:
    recording = simulate(NOMINAL, recording_rng(seed, NOMINAL.name, number))
    rng = fit_rng(seed, method.name, NOMINAL.name, number)
    return identify(method, recording, NOMINAL.model, rng)


def drawn(estimate: Estimate) -> Draws:
    assert estimate.draws is not None, estimate.sentence
    return estimate.draws


def spreads(draws: Draws) -> FloatArray:
    """Standard deviations on the scale of sampling, shape (parameters,)."""
    logs = np.log(np.where(draws.positive, draws.values, 1.0))
    points = np.where(draws.positive, logs, draws.values)
    offset = points - draws.weights @ points
    return np.asarray(np.sqrt(draws.weights @ offset**2))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    ratios = []
    for number in range(given.recordings):
        found = {name: drawn(fit(method, number, given.seed)) for name, method in LARGE.items()}
        ratios.append(spreads(found["importance"]) / spreads(found["emcee"]))
        sizes = ", ".join(f"{d.effective.min():.0f} ({name})" for name, d in found.items())
        print(f"recording {number}: at least {sizes} effective draws, R-hat of emcee "
              f"{found['emcee'].r_hat.max():.4f}")  # fmt: skip
    keys = found["emcee"].keys
    mean, worst = np.mean(ratios, axis=0), np.max(np.abs(np.array(ratios) - 1.0), axis=0)
    print("\nparameter  importance/emcee   farthest from 1")
    for key, own, far in zip(keys, mean, worst, strict=True):
        print(f"{key:10} {own:16.4f} {far:18.4f}")
    good = bool(np.all(np.abs(mean - 1.0) < 0.03))
    print()
    for name, method in USUAL.items():
        fits = [fit(method, 0, given.seed) for _ in range(3)]
        best = min(f.seconds for f in fits)
        draws = drawn(fits[0])
        good &= best < LIMITS[name] and fits[0].outcome.usable
        print(f"{name}: {best:.2f} s, at least {draws.effective.min():.0f} effective draws "
              f"of {len(draws.values)}")  # fmt: skip
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
