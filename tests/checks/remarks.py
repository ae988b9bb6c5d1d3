"""How often an estimate of `mle` is remarked on, and whether what is said holds of the truth.

    nox -s check -- remarks [--recordings 200] [--first 1000]

On recordings of populations, whose truth is known, and on recordings of human pilots that
PILOTID_MEASURED names, with the models of their experiments.
"""

from __future__ import annotations

import argparse
import os
import re
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

from pilotid.datasets import POPULATIONS, simulate
from pilotid.estimates.estimate import Estimate
from pilotid.estimates.method import identify
from pilotid.methods import method_named
from pilotid.pilot.catalogue import MODELS
from pilotid.pilot.model import PilotModel
from pilotid.recordings.files import load_recording
from pilotid.seeds import draw_rng, fit_rng, recording_rng

SEED = 1
#: Kinds of remarks, by words of theirs.
KINDS = {
    "are not white": "prediction errors are not white",
    "that is known": "product or ratio known alone",
    "so is the other": "cannot be told apart, nothing known",
    "people's delays": "delay below 0.1 s",
    "does not tell more": "known on one side only",
    "does not tell": "not known at all",
    "is pressed": "pressed against a bound",
    "hardly known": "interval spans more than a factor of 10",
    "on one side of the value": "lopsided interval",
    "cancel": "cancellation",
    "explains": "explains nothing",
    "straight back": "gain element, rests on the model of the remnant",
    "keeps its value": "u stays where it is",
    "u drifts": "drift",
    "another pilot than the second": "halves ask for different pilots",
    "during the recording": "pilot changes",
    "times the variance": "variance of halves",
}


def kind_of(remark: str) -> str:
    """The kind of a remark."""
    return next((kind for words, kind in KINDS.items() if words in remark), "others")


def holds(estimate: Estimate, remark: str, truth: dict[str, float]) -> bool | None:
    """Whether what a remark claims to know holds of the truth; None if it claims nothing."""
    for pair in estimate.inseparable:
        if pair.words == remark and pair.combination:
            power = -1.0 if "/" in pair.combination.key else 1.0
            value = truth[pair.first] * truth[pair.second] ** power
            return pair.combination.lower <= value <= pair.combination.upper
    if side := re.match(r"(\w+) is at (least|most) ([\d.e+-]+)", remark):
        key, which, end = side.groups()
        return truth[key] >= float(end) if which == "least" else truth[key] <= float(end)
    if "95 % interval" in remark:
        keys = [key for key in re.findall(r"(\w+) \(", remark) if key in truth]
        ends = [estimate[key].interval for key in keys]
        return all(low <= truth[key] <= high for key, (low, high) in zip(keys, ends, strict=True))
    return None


def of_a_population(name: str, first: int, count: int) -> None:
    """Print how often each kind of remark comes, and how often it holds."""
    population, method = POPULATIONS[name], method_named("mle")
    found: Counter[str] = Counter()
    held: dict[str, list[bool]] = defaultdict(list)
    outcomes: Counter[str] = Counter()
    silent = 0
    for i in range(first, first + count):
        scenario = population.drawn(draw_rng(SEED, name, i))
        recording = simulate(scenario, recording_rng(SEED, name, i))
        estimate = identify(method, recording, scenario.model, fit_rng(SEED, "mle", name, i))
        outcomes[estimate.outcome.slug] += 1
        truth = dict(zip(scenario.model.keys, scenario.truth, strict=True))
        for remark in estimate.remarks:
            claim = holds(estimate, remark, truth)
            if claim is not None:
                held[kind_of(remark)].append(claim)
        found.update({kind_of(remark) for remark in estimate.remarks})
        silent += not estimate.remarks
    print(f"{name}: {count} recordings, {dict(outcomes)}; no remark on {silent}")
    for kind, number in found.most_common():
        claims = held[kind]
        told = f"; holds of the truth in {sum(claims)} of {len(claims)}" if claims else ""
        print(f"    {kind}: on {number}{told}")


def of_human_pilots(folder: Path) -> None:
    """Print every remark on estimates from measured recordings."""
    yaw: dict[str, PilotModel] = {"C1": MODELS["lead-lag"], "C2": MODELS["single"]}
    yaw |= {"C3": MODELS["single"], "C4": MODELS["rate"], "C5": MODELS["rate"]}
    yaw["C6"] = MODELS["rate"]
    files = [(f, yaw[f.stem[-2:]]) for f in sorted(folder.glob("yaw/*.mat"))]
    files += [(f, MODELS["single"]) for f in sorted(folder.glob("adaptation/*_C[12]_*.mat"))]
    files += [(f, MODELS["single"]) for f in sorted(folder.glob("rollpitch/pilot*.csv"))]
    found: Counter[str] = Counter()
    silent, method = 0, method_named("mle")
    for file, model in files:
        recording = load_recording(file)
        estimate = identify(method, recording, model, np.random.default_rng(SEED))
        found.update({kind_of(remark) for remark in estimate.remarks})
        silent += not estimate.remarks
        for remark in estimate.remarks:
            print(f"    {file.stem} ({model.name}): {remark}")
    print(f"{len(files)} recordings of human pilots: no remark on {silent}; {dict(found)}")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--first", type=int, default=1000)
    options = parser.parse_args()
    for name in ("population-usual", "population-single", "population-exotic"):
        of_a_population(name, options.first, options.recordings)
    if folder := os.environ.get("PILOTID_MEASURED"):
        of_human_pilots(Path(folder))


if __name__ == "__main__":
    main()
