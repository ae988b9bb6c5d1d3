"""The store of a study: facts, scenarios, methods and fits.

It holds all that a report needs (truth, bounds, settings, versions), which is made from it alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pilotid.store import STORE, Rows, damaged
from pilotid.study.entries import MethodEntry, Result, ScenarioEntry, Unit

__all__ = ["STORE", "Store"]

#: Which rows are scenarios, methods and fits; that without names has the facts.
SCENARIOS = "scenario != '' AND method = ''"
METHODS = "scenario = '' AND method != ''"
FITS = "scenario != '' AND method != ''"


class Store(Rows):
    """A study's results in a folder; what is known already stays as it is."""

    format = 8

    def describe(self, about: Mapping[str, str]) -> None:
        """Keep facts on the study."""
        self.put(("", "", 0), {**self.about(), **about}, again=True)

    def about(self) -> dict[str, str]:
        """Facts on the study."""
        facts: dict[str, str] = self.get(dict[str, str], ("", "", 0)) or {}
        for key, value in facts.items():  # reports read numbers from some
            if not _is_readable(key, value):
                raise damaged(self.path, f"its fact '{key}' is none")
        return dict(sorted(facts.items()))

    def add_scenario(self, entry: ScenarioEntry) -> None:
        """Keep what a scenario is."""
        self.put((entry.name, "", 0), entry)

    def scenarios(self) -> list[ScenarioEntry]:
        """The scenarios, in the order of the catalogue."""
        found = self.every(ScenarioEntry, SCENARIOS)
        return sorted(found, key=lambda entry: (entry.position, entry.name))

    def add_method(self, entry: MethodEntry) -> None:
        """Keep what a method is."""
        self.put(("", entry.label, 0), entry)

    def methods(self) -> dict[str, MethodEntry]:
        """The methods by their labels, in the order of the catalogue."""
        found = self.every(MethodEntry, METHODS)
        found.sort(key=lambda entry: (entry.position, entry.label))
        return {entry.label: entry for entry in found}

    def add(self, result: Result) -> None:
        """Keep a fit."""
        unit = result.unit
        self.put((unit.scenario, unit.method, unit.replication), result)

    def forget(self, units: Iterable[Unit]) -> None:
        """Drop fits, which are then fitted again."""
        self.drop((unit.scenario, unit.method, unit.replication) for unit in units)

    def results(self) -> list[Result]:
        """All fits, by scenario, method and replication in the order of the catalogues."""
        scenarios, methods = [entry.name for entry in self.scenarios()], list(self.methods())
        places = {(s, m): (i, j) for i, s in enumerate(scenarios) for j, m in enumerate(methods)}
        found = {
            (*places[unit.scenario, unit.method], unit.replication): result
            for result in self.every(Result, FITS)
            if ((unit := result.unit).scenario, unit.method) in places
        }
        return [found[place] for place in sorted(found)]

    def done(self) -> dict[Unit, str]:
        """The fits that are in the store, and how they ended."""
        return {result.unit: result.outcome for result in self.every(Result, FITS)}


def _is_readable(key: str, value: str) -> bool:
    """Whether a fact is what reports take it for."""
    try:
        if key.startswith("remnant ratio "):
            float(value)
    except ValueError:
        return False
    return True
