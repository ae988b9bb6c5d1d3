"""Table of docs/analyse.md: two conditions of a pilot, with and without parameters in common.

nox -s check -- shared [--method fourier] [--recordings 100]
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from pilotid import SCENARIOS, Estimate, identify, simulate
from pilotid.estimates.shared import share
from pilotid.types import FloatArray

KEYS = ["fnm", "dnm"]
SCENARIO = SCENARIOS["single"]
TRUTHS = {"A": SCENARIO.values, "B": SCENARIO.values * [0.75, 1.3, 1.0, 1.0, 1.0]}


def told(estimates: list[Estimate], truth: FloatArray) -> str:
    """Standard deviation and claimed error [%], and coverage [%], of each parameter."""
    values = np.array([e.values for e in estimates]) / truth
    claimed = np.median([e.std_error for e in estimates], axis=0) / truth
    low, high = np.moveaxis(np.array([e.intervals for e in estimates]), 2, 0)
    covered = np.mean((low <= truth) & (truth <= high), axis=0)
    numbers = zip(SCENARIO.model.keys, values.std(axis=0), claimed, covered, strict=True)
    return ", ".join(f"{k} {100 * s:.2f} ({100 * c:.2f}) {100 * p:.0f}" for k, s, c, p in numbers)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--method", default="mle")
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--seed", type=int, default=77)
    options = parser.parse_args()
    alone: dict[str, list[Estimate]] = {name: [] for name in TRUTHS}
    shared: dict[str, list[Estimate]] = {name: [] for name in TRUTHS}
    chances = []
    for number in range(options.recordings):
        rng = np.random.default_rng([options.seed, number])
        pair = {}
        for name, truth in TRUTHS.items():
            recording = simulate(replace(SCENARIO, truth=tuple(truth)), rng)
            pair[name] = identify(options.method, recording, SCENARIO.model)
        together, test = share(pair, KEYS)
        if test is None:
            continue
        chances.append(test.p)
        for name in TRUTHS:
            alone[name].append(pair[name])
            shared[name].append(together[name])
    print("standard deviation (claimed) in %, and % of 95 % intervals that hold the truth")
    for name, truth in TRUTHS.items():
        print(f"{name} alone:  {told(alone[name], truth)}")
        print(f"{name} shared: {told(shared[name], truth)}")
    print(f"{len(chances)} pairs; p < .05 in {sum(p < 0.05 for p in chances)}")


if __name__ == "__main__":
    main()
