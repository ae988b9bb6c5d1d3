"""The truth of a simulation, for its file: written beside the recording, read by no method."""

from __future__ import annotations

from dataclasses import asdict

from pilotid.datasets.scenarios import Scenario
from pilotid.datasets.simulation import remnant_ratio
from pilotid.pilot.loops import margins


def truth(scenario: Scenario) -> dict[str, object]:
    """What a scenario's recordings were made of, as plain objects."""
    loops = []
    for end, _ in scenario.constant_ends:
        target, disturbance = margins(end.model, end.values, end.element)
        loops.append({"target": asdict(target), "disturbance": asdict(disturbance)})
    change = (
        {} if scenario.change is None else {"controlled_element_change": asdict(scenario.change)}
    )
    recorder = {} if scenario.recorder is None else {"recorder": asdict(scenario.recorder)}
    after = {"loops_after_the_change": loops[1]} if len(loops) > 1 else {}
    return {
        "scenario": scenario.name,
        "description": scenario.description,
        "model": scenario.model.name,
        "runs": scenario.runs,
        "parameters": {
            p.key: {"value": float(value), "unit": p.unit}
            for p, value in zip(scenario.model.parameters, scenario.values, strict=True)
        },
        "remnant": {**asdict(scenario.remnant), "expected_power_ratio": remnant_ratio(scenario)},
        "controlled_element": asdict(scenario.element),
        **change,
        **recorder,
        "loops": loops[0],
        **after,
    }
