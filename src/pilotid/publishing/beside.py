"""The page of one scenario: the methods of all studies side by side."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from pilotid.publishing.held import Held, difference
from pilotid.report import appendix
from pilotid.report import tables as study_tables
from pilotid.report.content import Block, Bullets, Command, Picture, Section, Text
from pilotid.report.glance import glance
from pilotid.report.population import overview
from pilotid.report.population_figures import by_stratum
from pilotid.report.population_verdicts import CODES as POPULATION_CODES
from pilotid.report.verdicts import CODES, judge, sentence
from pilotid.study.attempts import Attempts
from pilotid.study.comparison import Cell
from pilotid.study.entries import ScenarioEntry
from pilotid.study.population import PopulationCell

#: The folder of these pages.
FOLDER = "scenarios"


@dataclass(frozen=True, eq=False)
class Beside:
    """A scenario and the studies that have fits of it.

    Attributes
    ----------
    key
        What its page is called.
    entry
        The scenario, as the first of the studies has it.
    studies
        The studies.
    """

    key: str
    entry: ScenarioEntry
    studies: tuple[Held, ...]

    @property
    def link(self) -> str:
        """A link from the first page."""
        return f"[{self.entry.name}]({FOLDER}/{self.key}.html)"

    @property
    def attempts(self) -> list[tuple[Held, Attempts]]:
        """What methods did: in the order of the catalogue, one method's studies together."""
        name = self.entry.name
        found = [(held, each) for held in self.studies for each in held.study.tried_on(name)]
        places = {m.label: m.position for held in self.studies for m in held.methods.values()}
        return sorted(found, key=lambda pair: (places[pair[1].method], pair[1].method))

    def _labelled(self, held: Held, method: str) -> str:
        """A method's name, with that of the study where there are several."""
        return method if len(self.studies) == 1 else f"{method}, {held.name}"

    @property
    def cells(self) -> list[tuple[Held, Cell]]:
        """What methods did in the scenario, called by their names here."""
        return [
            (held, replace(each, method=self._labelled(held, each.method)))
            for held, each in self.attempts
            if isinstance(each, Cell)
        ]

    @property
    def population_cells(self) -> list[PopulationCell]:
        """The same on a population."""
        return [
            replace(each, method=self._labelled(held, each.method))
            for held, each in self.attempts
            if isinstance(each, PopulationCell)
        ]


def scenarios_beside(studies: Sequence[Held]) -> list[Beside]:
    """The scenarios of all studies; those of one name stand together if they are the same."""
    found: list[Beside] = []
    for held in studies:
        for name in held.study.all_names:
            entry = held.study.entry(name)
            same = next((b for b in found if _same(b.entry, entry)), None)
            if same is None:
                key = _free(name, [b.key for b in found])
                found.append(Beside(key, entry, (held,)))
            else:
                found[found.index(same)] = replace(same, studies=(*same.studies, held))
    return found


def _same(ours: ScenarioEntry, theirs: ScenarioEntry) -> bool:
    return ours.name == theirs.name and not difference(ours, theirs)


def _free(name: str, taken: Sequence[str]) -> str:
    plain = "".join(sign if sign.isalnum() or sign in "-_" else "-" for sign in name)
    plain = plain.encode("ascii", "replace").decode().replace("?", "-")
    names = (plain, *(f"{plain}-{number}" for number in range(2, 999)))
    return next(n for n in names if n not in taken)


def sections_of(beside: Beside) -> list[Section]:
    """The page's sections."""
    entry = beside.entry
    recordings = "; ".join(
        f"[{held.name}](../{held.name}/report.html) {held.study.replications([entry.name])} "
        f"recordings, seed {held.about.get('seed', '?')}"
        for held in beside.studies
    )
    what = f"{entry.description[:1].upper()}{entry.description[1:]}"
    about = Text(f"{what}; model {entry.model}. {recordings}.")
    blocks = _population(beside) if entry.population else list(_scenario(beside))
    own = Text(
        "Verdicts are those of each study's own report, whose rules count the comparisons in it."
    )
    commands = [
        Command(
            f"To reproduce what {held.name} has:",
            appendix.command(held.study, held.about, [entry.name], entry.name),
        )
        for held in beside.studies
    ]
    return [
        Section("methods", "Methods side by side", [about, *blocks, own]),
        Section("commands", "Commands", commands),
    ]


def _scenario(beside: Beside) -> Iterator[Block]:
    cells = beside.cells
    own = [cell for _, cell in cells]
    name = beside.entry.name
    if beside.entry.one_recording:
        yield Text("All fits are of one recording: bias and coverage say nothing of others.")
        yield study_tables.starts_table(own, ())
        return
    verdicts = [judge(cell, held.rules) for held, cell in cells]
    yield study_tables.verdict_table(verdicts, f"`{name}`: all parameters in a row for each method")
    yield Bullets([sentence(v) for v in verdicts])
    if any(math.isfinite(s.ratio) for cell in own for s in cell.percent):
        parameters = ", ".join(p.parameter for p in beside.entry.parameters)
        yield Picture.of(
            glance(own),
            f"glance-{beside.key}",
            f"Bias and rmse over the bound, and coverage, of each method in scenario {name}",
            f"Scenario {name}, one point for each parameter, from the top down {parameters}. "
            "Bars: 95 % Monte Carlo intervals. Bias: linear within ±1, logarithmic beyond; grey: "
            "a quarter of the bound; line: 95 % coverage.",
        ).with_pdf()
    yield replace(study_tables.scenario_table(own), folded=False, filters=(0, 1))
    yield Text(f"{CODES}.")


def _population(beside: Beside) -> list[Block]:
    cells = beside.population_cells
    blocks: list[Block] = [overview(cells)]
    shown = [cell for cell in cells if cell.values.recording.size]
    if shown:
        name = beside.entry.name
        caption = (
            f"`{name}`: share of the 95 % intervals that hold the truth, over all parameters, in "
            "parts of the recordings. Bars: 95 % Monte Carlo intervals; grey: 93.5 to 96.5 %."
        )
        alt = f"Coverage of 95 % intervals by part of {name} and method"
        picture = Picture.of(by_stratum(shown), f"coverage-{beside.key}", alt, caption)
        blocks.append(picture.with_pdf())
    return [*blocks, Text(f"{POPULATION_CODES}.")]
