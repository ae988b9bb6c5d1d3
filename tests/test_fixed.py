"""The fixed tasks are what the simulation makes, and methods find their truth."""

from __future__ import annotations

import json

import numpy as np
import pytest

import pilotid
from pilotid.datasets import fixed_tasks, load_task, scenario_named
from pilotid.datasets.named import TASKS
from pilotid.study.run import recording_of, scenario_of, truths_of
from pilotid.support.types import InputError

ROUNDING = 2.0**-23  # of numbers in single precision


def test_there_are_five_of_each_and_they_are_small() -> None:
    names = [name.rpartition("-")[0] for name in fixed_tasks()]
    assert {name: names.count(name) for name in names} == {
        **{"nominal": 5, "single": 5},
        **{"target-step": 5, "population-usual": 5},
    }
    assert sum(file.stat().st_size for file in TASKS.iterdir()) < 3e6
    with pytest.raises(InputError, match="unknown task 'nominal-5': choose from nominal-0"):
        load_task("nominal-5")


@pytest.mark.parametrize("name", fixed_tasks())
def test_the_simulation_makes_them_still(name: str) -> None:
    held = json.loads((TASKS / "truth.json").read_text())[name]
    task, origin = load_task(name), scenario_named(held["scenario"])
    recording = recording_of(origin, 1, held["replication"])
    assert list(task.recording.arrays) == list(recording.arrays)
    for signal, known in recording.arrays.items():
        stored = task.recording.arrays[signal]
        assert np.all(np.abs(stored - known) <= ROUNDING * np.abs(known) + 1e-12)
    facts = [(r.dt, r.run_in, r.units, r.lines) for r in (task.recording, recording)]
    assert facts[0] == facts[1]
    assert task.recording.controlled_element == recording.controlled_element
    known = truths_of(scenario_of(origin, 1, held["replication"]))
    assert [*held["truth"]] == list(task.model.keys)
    assert np.allclose(task.truth, [truth for *_, truth, _ in known], rtol=1e-12, atol=0.0)
    assert np.allclose(task.bound, [bound for *_, bound in known], rtol=1e-5, atol=0.0)


def test_a_method_finds_the_truth() -> None:
    for name in ("nominal-0", "single-1", "target-step-2"):
        task = load_task(name)
        estimate = pilotid.identify("mle", task.recording, task.model)
        assert np.all(np.abs(estimate.values - task.truth) < 4.0 * task.bound)
