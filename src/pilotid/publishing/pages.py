"""Static pages over several studies, which open from a disk without a network."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pilotid.analysis.board import BOARD, Board, left_out_blocks, read_board
from pilotid.disk import make_folder, strict_json, table_bytes, write_file
from pilotid.document import (
    Block,
    Bullets,
    Column,
    Command,
    LogAxis,
    Section,
    Table,
    Text,
    table_of,
    write_page,
)
from pilotid.naming.settings import shown
from pilotid.publishing.changes import difference, free_name, names_for, read_study
from pilotid.report.study import COLUMNS, LOSS, command, details, mixed, write_report
from pilotid.report.study_tables import key_of, ranked, ranking, ranking_columns
from pilotid.study.comparison import (
    ESTIMATES,
    SUMMARY,
    SUMMARY_COLUMNS,
    Comparison,
    MethodResults,
)
from pilotid.study.entries import ScenarioEntry
from pilotid.study.judge import RULES, sentence
from pilotid.study.study import LIBRARIES
from pilotid.types import InputError

TITLE = "Pilot-model identification: studies side by side"
INDEX = "index.html"
FOLDER = "scenarios"  # of the pages of scenarios, beside those of studies
#: All scores of all studies.
SCORES = "scores.csv"


@dataclass(frozen=True, eq=False)
class SharedScenario:
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
    studies: tuple[Comparison, ...]

    @property
    def link(self) -> str:
        """A link from the first page."""
        return f"[{self.entry.name}]({FOLDER}/{self.key}.html)"

    @property
    def cells(self) -> list[tuple[Comparison, MethodResults]]:
        """What methods did: in the order of the catalogue, one method's studies together."""
        found = [(study, cell) for study in self.studies for cell in study.of(self.entry.name)]
        places = {m.label: m.position for study in self.studies for m in study.entries.values()}
        return sorted(found, key=lambda pair: (places[pair[1].method], pair[1].method))

    @property
    def labelled(self) -> list[MethodResults]:
        """The same, methods called by the study as well where there are several."""
        several = len(self.studies) > 1
        return [
            replace(cell, method=f"{cell.method}, {study.name}") if several else cell
            for study, cell in self.cells
        ]


def publish(folders: Sequence[Path], out: Path) -> Path:
    """Write the pages; equal stores give equal bytes.

    Parameters
    ----------
    folders
        Folders of studies, or of analyses with runs left out; at least one.
    out
        Folder of the pages, which is made.

    Returns
    -------
    Path
        The first page.

    Raises
    ------
    InputError
        If a folder holds no study, or pages would be written over one.
    """
    names = dict(zip(folders, names_for(folders, (FOLDER,)), strict=True))
    boards = {
        name: read_board(folder / BOARD)
        for folder, name in names.items()
        if (folder / BOARD).is_file()
    }
    for folder in folders:
        if folder.resolve().parent == out.resolve() or folder.resolve() == out.resolve():
            raise InputError(
                f"{out}: pages there would be written over the study {folder}; name another "
                "folder with --out"
            )
    studies = [read_study(folder, name) for folder, name in names.items() if name not in boards]
    make_folder(out / FOLDER)
    for study in studies:
        _write_study(study, out / study.name)
    scenarios = shared_scenarios(studies)
    for shared in scenarios:
        page, title = out / FOLDER / f"{shared.key}.html", f"Scenario {shared.entry.name}"
        write_page(page, title, _scenario_page(shared), f"../{INDEX}", ("svg", "pdf"))
    rows = ([study.name, *row] for study in studies for row in study.summary_rows())
    columns = ("study", "scenario", "method", *SUMMARY_COLUMNS)
    write_file(out / SCORES, table_bytes(columns, rows))
    for name, board in boards.items():
        make_folder(out / name)
        write_file(out / name / BOARD, strict_json(board.to_dict()).encode())
    sections = [*_index(studies, scenarios), *_people(boards)]
    write_page(out / INDEX, TITLE, sections)
    return out / INDEX


def _write_study(study: Comparison, folder: Path) -> None:
    """A study's report with its figures and its tables."""
    make_folder(folder)
    study.write_tables(folder)
    write_report(folder, study, kinds=("svg", "pdf"), above=f"../{INDEX}")


def shared_scenarios(studies: Sequence[Comparison]) -> list[SharedScenario]:
    """The scenarios of all studies; those of one name stand together if they are the same."""
    found: list[SharedScenario] = []
    for study in studies:
        for entry in study.scenarios:
            same = [
                s for s in found if s.entry.name == entry.name and not difference(s.entry, entry)
            ]
            if same:
                place = found.index(same[0])
                found[place] = replace(same[0], studies=(*same[0].studies, study))
                continue
            plain = key_of(entry.name).encode("ascii", "replace").decode().replace("?", "-")
            key = free_name(plain, [shared.key for shared in found])
            found.append(SharedScenario(key, entry, (study,)))
    return found


def _scenario_page(shared: SharedScenario) -> list[Section]:
    """One scenario: the methods of all studies side by side."""
    entry, cells = shared.entry, shared.labelled
    recordings = "; ".join(
        f"[{study.name}](../{study.name}/report.html) {study.replications([entry.name])} "
        f"recordings, seed {study.about.get('seed', '?')}"
        for study in shared.studies
    )
    what = f"{entry.description[:1].upper()}{entry.description[1:]}"
    blocks: list[Block] = [Text(f"{what}; model {entry.model}. {recordings}.")]
    if entry.one_recording:
        blocks.append(Text("All fits are of one recording: means say nothing of others."))
    blocks.append(ranking(cells))
    blocks.append(Bullets([sentence(cell.method, cell.scores) for cell in ranked(cells)]))
    key = key_of(entry.name)
    commands = [
        Command(f"To reproduce what {study.name} has:", command(study, [entry.name], key))
        for study in shared.studies
    ]
    return [
        Section("methods", "Methods side by side", blocks),
        Section("details", "Details", details(cells, f"{shared.key}", linked=False)),
        Section("reading", "How to read the numbers", [Text(LOSS), Text(COLUMNS), Text(RULES)]),
        Section("commands", "Commands", commands),
    ]


def _index(studies: Sequence[Comparison], scenarios: Sequence[SharedScenario]) -> list[Section]:
    """The first page's sections on simulated recordings; none without studies."""
    if not studies:
        return []
    return [
        Section("results", "Methods and scenarios", _results(studies, scenarios)),
        Section("studies", "Studies", _studies(studies)),
        Section("methods", "Methods and their settings", [_methods(studies)]),
        Section("scenarios", "Scenarios", [_scenarios(scenarios)]),
    ]


def _people(boards: Mapping[str, Board]) -> Iterator[Section]:
    """Recordings of people, by the name of the analysis; the recordings themselves stay outside."""
    for name, board in boards.items():
        versions = ", ".join(f"{what} {version}" for what, version in board.versions.items())
        taken = Text(f"[All runs]({name}/{BOARD}) as a file. Versions: {versions}.")
        again = Command("To make it again, with the recordings:", board.command)
        blocks = [*left_out_blocks(board), taken, again]
        yield Section(f"people-{name}", f"Recordings of people: {name}", blocks)


def _results(studies: Sequence[Comparison], scenarios: Sequence[SharedScenario]) -> list[Block]:
    fits = sum(study.fits for study in studies)
    what = (
        f"{len(studies)} studies, {len(scenarios)} scenarios, {fits} fits of simulated recordings "
        f"whose truth is known. A scenario's page has its methods side by side; "
        f"[{SCORES}]({SCORES}) has every score, and each study its rows."
    )
    origin = {cell: (shared, study) for shared in scenarios for study, cell in shared.cells}
    orders = [ranked([cell for _, cell in shared.cells]) for shared in scenarios]
    best = {cell: order[0] for order in orders for cell in order}
    method, *columns = ranking_columns(best, LogAxis(-0.1, 2.0))
    front = [
        Column("scenario", lambda c: origin[c][0].link),
        method,
        Column("study", lambda c: f"[{origin[c][1].name}]({origin[c][1].name}/report.html)"),
    ]
    caption = "What every method did, by scenario and study, in the order of the loss"
    table = Table(caption, [*front, *columns], list(best), heads=2, filters=(0, 1, 2))
    return [Text(what), table, Text(LOSS), Text(COLUMNS), Text(RULES)]


def _studies(studies: Sequence[Comparison]) -> list[Block]:
    facts = ("seed", "pilotid", "code", "python", *(n for n in LIBRARIES if n in studies[0].about))
    rows = [
        (
            f"[{s.name}]({s.name}/report.html)",
            f"[fits]({s.name}/{ESTIMATES}), [scores]({s.name}/{SUMMARY})",
            *(len(s.names), len(s.methods), s.replications(s.names), s.fits),
            *map(s.about.get, facts),
        )
        for s in studies
    ]
    numbers = [(title, str) for title in ("scenarios", "methods", "recordings", "fits")]
    named = [("code digest" if name == "code" else name,) for name in facts]
    heads = [("study",), ("rows",), *numbers, *named]
    blocks: list[Block] = [table_of("What each study is of", heads, rows)]
    for study in studies:
        if "mixed" in study.about:
            blocks.append(Text(f"**{study.name}: {mixed(study)}**"))
        if study.cells:
            whole = command(study, study.names, study.name)
            blocks.append(Command(f"To make {study.name} again:", whole))
        else:
            blocks.append(Text(f"{study.name} holds no fits yet."))
    return blocks


def _methods(studies: Sequence[Comparison]) -> Table[Any]:
    rows = [
        (
            *(label, study.name, f"`{shown(own.settings)}`", f"`{own.typed or label}`"),
            f"of its own, digest {own.code}" if own.code else "of pilotid",
        )
        for study in studies
        for label, own in study.entries.items()
    ]
    heads = [(title,) for title in ("method", "study", "settings", "to type", "code")]
    return table_of("All that defines each method", heads, rows, 2)


def _scenarios(scenarios: Sequence[SharedScenario]) -> Table[Any]:
    rows = [
        (
            *(s.link, ", ".join(study.name for study in s.studies)),
            *(s.entry.description, s.entry.model),
            ", ".join(f"{p.parameter} {p.truth:.4g} {p.unit}".rstrip() for p in s.entry.parameters)
            or "drawn for each recording",
        )
        for s in scenarios
    ]
    heads = [(title,) for title in ("scenario", "studies", "description", "model", "truth")]
    return table_of("What each scenario is", heads, rows)
