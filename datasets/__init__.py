"""Simulated data sets whose truth is known."""

from pilotid.datasets.population import POPULATIONS, Population
from pilotid.datasets.scenarios import SCENARIOS, Scenario, scenario_named, scenarios_named
from pilotid.datasets.simulation import simulate

__all__ = [
    "POPULATIONS",
    "SCENARIOS",
    "Population",
    "Scenario",
    "scenario_named",
    "scenarios_named",
    "simulate",
]
