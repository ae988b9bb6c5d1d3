"""Controlled elements identified from u, fd and x: against the truth, and of human pilots.

    python tests/checks/elements.py [--replications 50] [--seed 1]

The first table has recordings of populations, whose element is known: how many were found of the
right form, how far the response is off from 0.3 to 17 rad/s, how many are remarked on or said to
differ from what the file names, and how long it took.  The second counts what is said of fitted
loops.  The third has the recordings of human pilots that PILOTID_MEASURED names.
"""

from __future__ import annotations

import argparse
import os
import re
import time
from collections import Counter
from pathlib import Path

import numpy as np

from pilotid.datasets import POPULATIONS, simulate
from pilotid.element.fit import chosen_element, identified_element
from pilotid.estimates.loops import loops_of
from pilotid.estimates.method import identify
from pilotid.methods.mle import MLE
from pilotid.recordings.files import load_recording
from pilotid.support.numbers import draw_rng, fit_rng, recording_rng
from pilotid.support.types import InputError

OMEGA = np.geomspace(0.3, 17.0, 100)


def populations(replications: int, seed: int) -> None:
    print("| population | right form | largest deviation [%] | remarks | median time [ms] |")
    print("| --- | --- | --- | --- | --- |")
    for name, population in POPULATIONS.items():
        right, remarked, off, spent = 0, 0, 0.0, []
        for i in range(replications):
            scenario = population.drawn(draw_rng(seed, name, i))
            recording = simulate(scenario, recording_rng(seed, name, i))
            begin = time.process_time()
            choice = chosen_element(recording)
            spent.append(time.process_time() - begin)
            found, true = choice.identified, scenario.element
            remarked += bool(found.remark or choice.remarks)
            if found.element is None:
                continue
            right += len(found.element.denominator) == len(true.denominator)
            ratio = found.element.response(OMEGA) / true.response(OMEGA)
            off = max(off, float(np.max(np.abs(ratio - 1.0))))
        times = f"{1e3 * float(np.median(spent)):.0f}"
        cells = (name, f"{right} of {replications}", f"{100.0 * off:.2f}", str(remarked), times)
        print(f"| {' | '.join(cells)} |", flush=True)


def loops(replications: int, seed: int) -> None:
    said: Counter[str] = Counter()
    fitted = 0
    for name in ("population-usual", "population-single"):
        for i in range(replications):
            scenario = POPULATIONS[name].drawn(draw_rng(seed, name, i))
            recording = simulate(scenario, recording_rng(seed, name, i))
            rng = fit_rng(seed, "mle", name, i)
            estimate = identify(MLE(), recording, scenario.model, rng)
            if not estimate.outcome.usable:
                continue
            fitted += 1
            found = loops_of(estimate, scenario.element)
            said["unstable"] += bool(found.remarks)
            said["target loop without a crossover"] += bool(found.target.remark)
            said["disturbance loop without a crossover"] += bool(found.disturbance.remark)
            said["a further crossing"] += bool(found.target.others or found.disturbance.others)
    print(f"\nof {fitted} fits of `mle` on population-usual and population-single:")
    for words, count in said.items():
        print(f"- {words}: {count}")


def measured(folder: Path) -> None:
    print("\n| recordings of human pilots | files | element |")
    print("| --- | --- | --- |")
    found: Counter[tuple[str, str]] = Counter()
    for file in sorted([*folder.rglob("*.mat"), *folder.rglob("*.csv")]):
        try:
            recording = load_recording(file)
        except InputError:
            continue  # forcing functions and the like
        element = identified_element(recording)
        experiment = f"{file.parent.name} C{file.stem.partition('C')[2][:1]}"
        if element.sound and element.element is not None:
            words = element.element.name
        else:
            words = re.sub(r"explains \d+ %", "explains part", element.remark.partition(", as")[0])
        found[experiment, words] += 1
    for (experiment, words), count in sorted(found.items()):
        print(f"| {experiment} | {count} | {words} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--replications", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    populations(given.replications, given.seed)
    loops(given.replications, given.seed)
    if os.environ.get("PILOTID_MEASURED"):
        measured(Path(os.environ["PILOTID_MEASURED"]))
