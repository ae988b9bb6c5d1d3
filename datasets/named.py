"""Scenarios and populations by name; those of your own are named as ``file.py:NAME``."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from pilotid.datasets.designed import designed_scenario
from pilotid.datasets.population import POPULATIONS, Population
from pilotid.datasets.scenarios import SCENARIOS, Scenario, checked, require_name
from pilotid.naming.code import is_place, taken
from pilotid.naming.settings import configured, split_call
from pilotid.types import InputError

#: What a study has recordings of: both have a name, a description, and `drawn`, which gives
#: the scenario of a replication.
AnyScenario = Scenario | Population

#: Scenarios and populations by the name that the command line takes.
CATALOGUE: dict[str, AnyScenario] = {**SCENARIOS, **POPULATIONS}


def scenarios_named(text: str) -> list[AnyScenario]:
    """The scenarios and populations that a text names.

    Parameters
    ----------
    text
        ``nominal``, ``nominal(runs=3)``, the ``design.json`` of a design, or ``file.py:NAME`` or
        ``package.module:NAME`` for a scenario, a population or a list of them.

    Raises
    ------
    InputError
        If there is none; the message lists the names there are.
    """
    if text.strip().lower().endswith(".json"):
        return [sound(designed_scenario(Path(text.strip())))]
    if not is_place(text):
        return [_from_catalogue(text)]
    thing = taken(text)
    own = list(thing) if isinstance(thing, list | tuple) else [thing]
    if not own or not all(isinstance(each, AnyScenario) for each in own):
        raise InputError(f"{text}: is no Scenario, no Population and no list of them")
    return [sound(each) for each in own]


def scenario_named(text: str) -> AnyScenario:
    """The one scenario that a text names, see `scenarios_named`."""
    first, *others = scenarios_named(text)
    if others:
        names = ", ".join(scenario.name for scenario in (first, *others))
        raise InputError(f"{text}: holds several scenarios ({names}); name one of them")
    return first


def _from_catalogue(text: str) -> AnyScenario:
    name, settings = split_call(text)
    if name not in CATALOGUE:
        there = ", ".join(CATALOGUE)
        raise InputError(f"unknown scenario '{name}': choose from {there}, or name file.py:NAME")
    scenario = CATALOGUE[name]
    changed = configured(scenario, settings, text)
    if changed == scenario or changed.name != name:
        return sound(changed)
    # Its name goes into files and links.
    signs = re.sub(r"[^\w.]+", "-", f"{name}({settings})", flags=re.ASCII).strip("-")
    if isinstance(changed, Scenario):
        changed = replace(changed, family="", varied="")
    return sound(replace(changed, name=signs))


def sound(thing: object) -> AnyScenario:
    """A scenario or population, if its name is its own.

    Raises
    ------
    InputError
        If the name belongs to another one, or cannot be that of a file; see `checked`, too.
    """
    known = thing if isinstance(thing, Population) else checked(thing)
    require_name(known.name)
    if CATALOGUE.get(known.name, known) != known:
        raise InputError(
            f"a scenario has the name '{known.name}' of another one; give it a name of its own"
        )
    return known
