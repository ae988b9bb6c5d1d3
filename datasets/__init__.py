"""Simulated data sets whose truth is known."""

from pilotid.datasets.named import (
    CATALOGUE,
    AnyScenario,
    FixedTask,
    fixed_tasks,
    load_task,
    reference_posterior,
    scenario_named,
)
from pilotid.datasets.population import POPULATIONS, Population
from pilotid.datasets.scenarios import SCENARIOS, Scenario
from pilotid.datasets.simulation import simulate

__all__ = [
    "CATALOGUE",
    "POPULATIONS",
    "SCENARIOS",
    "AnyScenario",
    "FixedTask",
    "Population",
    "Scenario",
    "fixed_tasks",
    "load_task",
    "reference_posterior",
    "scenario_named",
    "simulate",
]
