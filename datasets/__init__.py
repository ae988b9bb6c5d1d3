"""Simulated data sets whose truth is known."""

from pilotid.datasets.loop import simulate
from pilotid.datasets.scenarios import SCENARIOS, Scenario, scenario_named

__all__ = ["SCENARIOS", "Scenario", "scenario_named", "simulate"]
