"""Simulated data sets whose truth is known."""

from pilotid.datasets.scenarios import SCENARIOS, Scenario, scenario_named, scenarios_named
from pilotid.datasets.simulation import simulate

__all__ = ["SCENARIOS", "Scenario", "scenario_named", "scenarios_named", "simulate"]
