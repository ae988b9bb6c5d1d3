"""How often the choice of a model finds the one that made a recording.

For each model of the catalogue a pilot in a stable loop (those of the tests) is simulated, and the
catalogue's models compete as `pilotid fit --model auto` has it.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from helpers import PILOTS

from pilotid.datasets import simulate
from pilotid.model_choice import select
from pilotid.support.numbers import recording_rng


def main() -> None:
    """Print a table: the model simulated, the number of runs, and what was chosen how often."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=20)
    parser.add_argument("--runs", type=int, nargs="+", default=[1, 3, 10])
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    print(f"{given.recordings} recordings each, seed {given.seed}")
    print("| model | runs | chosen |\n| --- | --- | --- |")
    for name, scenario in PILOTS.items():
        for runs in given.runs:
            several = replace(scenario, runs=runs)
            found = Counter(
                select(simulate(several, recording_rng(given.seed, name, k))).model.name
                for k in range(given.recordings)
            )
            told = ", ".join(f"{model} {count}" for model, count in found.most_common())
            print(f"| {name} | {runs} | {told} |", flush=True)


if __name__ == "__main__":
    main()
