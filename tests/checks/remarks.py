"""How often sound recordings and their estimates are remarked on, and whether what is said holds.

    nox -s check -- remarks --recordings 500 [--first 1000] [--only population-inner,stepped]

Populations, whose truth is known; `stepped`, a generator that shares no code with them; and the
recordings of human pilots that PILOTID_MEASURED names.  What is graded wrong or doubt of a
simulated recording is a false alarm.
"""

from __future__ import annotations

import argparse
import os
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from stepping import TRUTH, stepped

from pilotid.datasets import POPULATIONS, simulate
from pilotid.estimates.estimate import Estimate, Outcome
from pilotid.estimates.method import identify
from pilotid.methods import method_named
from pilotid.pilot.catalogue import MODELS
from pilotid.pilot.model import PilotModel
from pilotid.recordings.checks import remarks
from pilotid.recordings.files import load_recording
from pilotid.recordings.recording import Recording
from pilotid.support.numbers import draw_rng, fit_rng, recording_rng
from pilotid.support.remarks import Remark, remark_of

SEED = 1
STEPPED = "stepped"
NAMES = ("usual", "single", "exotic", "aperiodic", "rates", "recorded", "inner", "short")
BATCH = 50
FAR = 3.0  # claimed errors


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


def drawn(
    name: str, first: int, count: int
) -> Iterator[tuple[Recording, PilotModel, dict[str, float]]]:
    """Recordings of a population, or of `stepped`, each with its model and truth."""
    if name == STEPPED:
        for batch in range(0, count, BATCH):
            rng = np.random.default_rng([SEED, first + batch])
            for truth, recording in stepped(rng, min(BATCH, count - batch)):
                yield recording, MODELS["single"], dict(zip(TRUTH, truth, strict=True))
        return
    population = POPULATIONS[name]
    for i in range(first, first + count):
        scenario = population.drawn(draw_rng(SEED, name, i))
        recording = simulate(scenario, recording_rng(SEED, name, i))
        yield recording, scenario.model, dict(zip(scenario.model.keys, scenario.truth, strict=True))


def all_remarks(recording: Recording, estimate: Estimate) -> dict[str, Remark]:
    """What is said of a recording and of its fit, by code."""
    said = [*remarks(recording), *(remark_of(text) for text in estimate.remarks)]
    return {remark.code: remark for remark in said}


def of_simulations(name: str, first: int, count: int) -> None:
    """Print how often each code comes, and how often what it claims holds of the truth."""
    method = method_named("mle")
    found: Counter[tuple[str, str]] = Counter()
    held: dict[str, list[bool]] = defaultdict(list)
    outcomes: Counter[str] = Counter()
    alarmed = rightly = covered = known = 0
    for i, (recording, model, truth) in enumerate(drawn(name, first, count), first):
        estimate = identify(method, recording, model, fit_rng(SEED, "mle", name, i))
        outcomes[estimate.outcome.slug] += 1
        said = all_remarks(recording, estimate)
        for remark in estimate.remarks:
            if (claim := holds(estimate, remark, truth)) is not None:
                held[remark_of(remark).code].append(claim)
        found.update((remark.grade, code) for code, remark in said.items())
        alarm = [code for code, remark in said.items() if remark.grade != "note"]
        alarmed += bool(alarm)
        if alarm:
            off = np.abs(estimate.values - [truth[key] for key in model.keys])
            rightly += not bool(np.all(off <= FAR * estimate.std_error))
            print(f"    {name} {i}: {', '.join(sorted(alarm))}", flush=True)
        elif estimate.outcome is Outcome.CONVERGED:
            inside = [
                low <= truth[q.key] <= high
                for q in estimate.parameters
                for low, high in [q.interval]
            ]
            covered, known = covered + sum(inside), known + len(inside)
    share = alarmed / count
    error = np.sqrt(share * (1.0 - share) / count)
    print(
        f"{name}: {count} recordings, {dict(outcomes)}; wrong or doubt is said of {alarmed} "
        f"({100 * share:.1f} +- {100 * error:.1f} %), where {rightly} fits are off by more "
        f"than {FAR:g} claimed errors; of the others {covered / max(known, 1):.3f} "
        f"of {known} intervals hold the truth",
        flush=True,
    )
    for (grade, code), number in sorted(found.items(), key=lambda item: -item[1]):
        claims = held[code]
        told = f"; holds of the truth in {sum(claims)} of {len(claims)}" if claims else ""
        print(f"    {grade} {code}: on {number}{told}", flush=True)


def of_human_pilots(folder: Path) -> None:
    """Print what is said of every measured recording and of its estimate."""
    yaw: dict[str, PilotModel] = {"C1": MODELS["lead-lag"], "C2": MODELS["single"]}
    yaw |= {"C3": MODELS["single"], "C4": MODELS["rate"], "C5": MODELS["rate"]}
    yaw["C6"] = MODELS["rate"]
    files = [(f, yaw[f.stem[-2:]]) for f in sorted(folder.glob("yaw/*.mat"))]
    files += [(f, MODELS["single"]) for f in sorted(folder.glob("adaptation/*_C[12]_*.mat"))]
    files += [(f, MODELS["single"]) for f in sorted(folder.glob("rollpitch/pilot*.csv"))]
    method = method_named("mle")
    for file, model in files:
        recording = load_recording(file)
        estimate = identify(method, recording, model, np.random.default_rng(SEED))
        for remark in all_remarks(recording, estimate).values():
            print(f"    {file.stem} ({model.name}), {remark.grade} {remark.code}: {remark}")
    print(f"{len(files)} recordings of human pilots")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--only", default=",".join([f"population-{n}" for n in NAMES] + [STEPPED]))
    options = parser.parse_args()
    for name in options.only.split(","):
        of_simulations(name, options.first, options.recordings)
    if folder := os.environ.get("PILOTID_MEASURED"):
        of_human_pilots(Path(folder))


if __name__ == "__main__":
    main()
