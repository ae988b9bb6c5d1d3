"""How often pilots are said to change: `nox -s check -- constancy`.

Constant pilots first, for the level of the test (5 and 1 %, with its Monte Carlo error), then
pilots who change, for its power.  `--measured` tests recordings of people, all runs of a
condition jointly (PILOTID_MEASURED names the folder above them).
"""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pilotid.datasets import POPULATIONS, SCENARIOS, Scenario, simulate
from pilotid.datasets.population import Population
from pilotid.model_choice import select
from pilotid.pilot.catalogue import SINGLE
from pilotid.recordings.files import load_recording
from pilotid.recordings.recording import Recording
from pilotid.support.limits import ESTIMATE
from pilotid.support.numbers import fit_rng, recording_rng
from pilotid.time_domain.constancy import Constancy, constancy_of

CHANGING = ("adapting-slow", "adapting-fast")
#: Which recordings of people are of a constant element, and which of one that changes.
STAYS = {"C1", "C2"}
AXES = {"C3": "roll", "C4": "pitch", "C6": "roll", "C7": "pitch"}  # the others: both


def constant() -> Iterator[Scenario | Population]:
    """Scenarios and populations of pilots who do not change."""
    single = SCENARIOS["single"]
    yield single
    yield replace(single, name="single, 5 runs", runs=5)
    yield replace(single, name="single, 30 s", duration=30.0)
    for number, (end, _) in enumerate(SCENARIOS["adapting-slow"].constant_ends, start=1):
        yield replace(end, name=f"target alone, element {number}")
    yield POPULATIONS["population-single"]
    for name in ("short", "exotic"):
        own = POPULATIONS[f"population-{name}"]
        yield replace(own, name=f"{own.name}, single", models=("single",))
    yield SCENARIOS["nominal"]


def changing() -> Iterator[Scenario]:
    """Pilots who change, and one who changes a little, early and at once."""
    for name in CHANGING:
        for level in (5, 15, 25):
            yield _with_remnant(name, level)
    little = _with_remnant("adapting-fast", 25)
    for truth, words in (
        ((0.08, 0.07, 0.6, 0.85, 41.92, 0.5, 0.28, 11.25, 0.35), "a little, half-way"),
        ((0.08, 0.06, 0.6, 1.1, 12.0, 100.0, 0.28, 11.25, 0.35), "more, after 12 s"),
    ):
        yield replace(little, name=f"remnant 25 %, {words}", truth=truth)


def _with_remnant(name: str, percent: int) -> Scenario:
    """A scenario with a remnant of another share of the control's power."""
    own = SCENARIOS[name]
    remnant = replace(own.remnant, level=percent / 100.0)
    return replace(own, name=f"{name}, remnant {percent} %", remnant=remnant)


def chances(scenario: Scenario | Population, count: int, seed: int) -> list[float]:
    """p of simulated recordings, each fitted with the constant model."""
    found = []
    for replication in range(count):
        rng = recording_rng(seed, scenario.name, replication)
        own = scenario.drawn(rng)
        model = SINGLE if own.changes else own.model
        tested = constancy_of(simulate(own, rng), model, fit_rng(seed, "constancy"))
        found.append(1.0 if tested is None else tested.p)
    return found


def shown(name: str, p: Sequence[float]) -> None:
    """A line of the table."""
    cells = []
    for level in (0.05, 0.01, 0.001):
        share = float(np.mean(np.array(p) <= level))
        error = math.sqrt(level * (1.0 - level) / len(p))
        cells.append(f"{share:.3f} ({level:g} +- {error:.3f})")
    print(f"| {name} | {len(p)} | {' | '.join(cells)} |", flush=True)


def simulated(count: int, seed: int) -> None:
    """Level and power."""
    print("| recordings | n | p <= .05 | p <= .01 | p <= .001 |")
    print("| --- | --- | --- | --- | --- |")
    every: list[float] = []
    for scenario in constant():
        found = chances(scenario, count, seed)
        every += found
        shown(scenario.name, found)
    shown("all constant pilots", every)
    for scenario in changing():
        shown(scenario.name, chances(scenario, max(20, count // 3), seed))


def measured() -> None:
    """People, by experiment, condition and axis."""
    folder = Path(os.environ["PILOTID_MEASURED"])
    groups: dict[str, list[Constancy]] = {}
    for path in sorted([*folder.glob("adaptation/*.mat"), *folder.glob("yaw/*.mat")]):
        recording: Recording = load_recording(path)
        model = select(recording).model
        tested = constancy_of(recording, model, fit_rng(1, "constancy"))
        assert tested is not None
        name = "yaw, element stays"
        if path.parent.name == "adaptation":
            _, condition, axis = path.stem.split("_")
            changes = condition not in STAYS and AXES.get(condition, axis) == axis
            name = f"{axis}, element {'changes' if changes else 'stays'}"
            name += " in both axes" if condition in STAYS else ""
        print(
            f"{path.stem}, {model.name}: p = {tested.p:.2g}, best at {tested.time:.1f} s, {tested}",
            flush=True,
        )
        groups.setdefault(name, []).append(tested)
    for name, own in sorted(groups.items()):
        certain = sum(tested.p < ESTIMATE.changes for tested in own)
        said = sum(tested.changes for tested in own)
        size = 100.0 * float(np.median([tested.size for tested in own]))
        print(
            f"{name}: {len(own)} recordings, p < {ESTIMATE.changes:g} in {certain}, "
            f"said to change {said}; largest change of a gain or lead {size:.0f} % in the median"
        )


def main() -> None:
    """Run what the options ask for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=100, help="of each constant pilot")
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--measured", action="store_true")
    options = parser.parse_args()
    if options.measured:
        measured()
    else:
        simulated(options.recordings, options.seed)


if __name__ == "__main__":
    main()
