"""Static pages over several studies, which open from a disk without a network."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pilotid.analysis.board import BOARD, Board, read_board
from pilotid.analysis.report_left_out import left_out_blocks
from pilotid.disk import make_folder, strict_json, table_bytes, write_file
from pilotid.naming.settings import shown
from pilotid.numbers import NONE
from pilotid.publishing.studies import StudyData, difference, names_for, read_study
from pilotid.report.content import (
    Block,
    Bullets,
    Column,
    Command,
    Entry,
    Section,
    Table,
    Text,
    entries,
    web_page,
    write_pictures,
)
from pilotid.report.page import COLUMNS, LOSS, details, write_report
from pilotid.report.provenance import command, mixed
from pilotid.report.tables import key_of, ranked, ranking
from pilotid.study.archive import KEPT
from pilotid.study.comparison import ESTIMATES, SUMMARY, SUMMARY_COLUMNS, Cell
from pilotid.study.entries import ScenarioEntry
from pilotid.study.judge import RULES, sentence
from pilotid.study.store import Store
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
    studies: tuple[StudyData, ...]

    @property
    def link(self) -> str:
        """A link from the first page."""
        return f"[{self.entry.name}]({FOLDER}/{self.key}.html)"

    @property
    def cells(self) -> list[tuple[StudyData, Cell]]:
        """What methods did: in the order of the catalogue, one method's studies together."""
        found = [(data, cell) for data in self.studies for cell in data.study.of(self.entry.name)]
        places = {m.label: m.position for data in self.studies for m in data.methods.values()}
        return sorted(found, key=lambda pair: (places[pair[1].method], pair[1].method))

    @property
    def labelled(self) -> list[Cell]:
        """The same, methods called by the study as well where there are several."""
        several = len(self.studies) > 1
        return [
            replace(cell, method=f"{cell.method}, {data.name}") if several else cell
            for data, cell in self.cells
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
    for data in studies:
        _write_study(data, out / data.name)
    scenarios = shared_scenarios(studies)
    for shared in scenarios:
        sections = [section.with_pdfs() for section in _scenario_page(shared)]
        write_pictures(out / FOLDER, sections)
        page = web_page(f"Scenario {shared.entry.name}", sections, f"../{INDEX}")
        write_file(out / FOLDER / f"{shared.key}.html", page.encode("utf-8", "replace"))
    rows = ([data.name, *row] for data in studies for row in data.study.summary_rows())
    columns = ("study", "scenario", "method", *SUMMARY_COLUMNS)
    write_file(out / SCORES, table_bytes(columns, rows))
    for name, board in boards.items():
        make_folder(out / name)
        write_file(out / name / BOARD, strict_json(board.to_dict()).encode())
    sections = [*_index(studies, scenarios), *_people(boards)]
    write_file(out / INDEX, web_page(TITLE, sections).encode("utf-8", "replace"))
    return out / INDEX


def _write_study(data: StudyData, folder: Path) -> None:
    """A study's report with its figures, its tables, and its rows in their small form."""
    make_folder(folder)
    with Store(data.folder) as store:
        store.keep(folder)
        data.study.write_tables(folder)
        write_report(folder, store, data.study, pdf=True, above=f"../{INDEX}")


def shared_scenarios(studies: Sequence[StudyData]) -> list[SharedScenario]:
    """The scenarios of all studies; those of one name stand together if they are the same."""
    found: list[SharedScenario] = []
    for data in studies:
        for entry in data.study.scenarios:
            same = next(
                (i for i, shared in enumerate(found)
                 if shared.entry.name == entry.name and not difference(shared.entry, entry)),
                None,
            )  # fmt: skip
            if same is None:
                plain = key_of(entry.name).encode("ascii", "replace").decode().replace("?", "-")
                taken = {shared.key for shared in found}
                keys = (plain, *(f"{plain}-{number}" for number in range(2, 999)))
                found.append(
                    SharedScenario(next(k for k in keys if k not in taken), entry, (data,))
                )
            else:
                found[same] = replace(found[same], studies=(*found[same].studies, data))
    return found


def _scenario_page(shared: SharedScenario) -> list[Section]:
    """One scenario: the methods of all studies side by side."""
    entry, cells = shared.entry, shared.labelled
    recordings = "; ".join(
        f"[{data.name}](../{data.name}/report.html) {data.study.replications([entry.name])} "
        f"recordings, seed {data.about.get('seed', '?')}"
        for data in shared.studies
    )
    what = f"{entry.description[:1].upper()}{entry.description[1:]}"
    blocks: list[Block] = [Text(f"{what}; model {entry.model}. {recordings}.")]
    if entry.one_recording:
        blocks.append(Text("All fits are of one recording: means say nothing of others."))
    blocks.append(ranking(cells))
    blocks.append(Bullets([sentence(cell.method, cell.scores) for cell in ranked(cells)]))
    commands = [
        Command(
            f"To reproduce what {data.name} has:",
            command(data.study, data.about, [entry.name], key_of(entry.name)),
        )
        for data in shared.studies
    ]
    return [
        Section("methods", "Methods side by side", blocks),
        Section("details", "Details", details(cells, f"{shared.key}", linked=False)),
        Section("reading", "How to read the numbers", [Text(LOSS), Text(COLUMNS), Text(RULES)]),
        Section("commands", "Commands", commands),
    ]


def _index(studies: Sequence[StudyData], scenarios: Sequence[SharedScenario]) -> list[Section]:
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


def _results(studies: Sequence[StudyData], scenarios: Sequence[SharedScenario]) -> list[Block]:
    fits = sum(data.fits for data in studies)
    what = (
        f"{len(studies)} studies, {len(scenarios)} scenarios, {fits} fits of simulated recordings "
        f"whose truth is known. A scenario's page has its methods side by side; "
        f"[{SCORES}]({SCORES}) has every score, and each study its rows."
    )
    columns: list[Column] = []
    rows: list[list[Entry]] = []
    for shared in scenarios:
        # A ranking's columns differ by what there is to tell: the first ones are always there.
        table = ranking(shared.labelled, axis=(-0.1, 2.0))
        head, ends = Column("scenario", text=True), (*table.columns[1:7], table.columns[-1])
        columns = [head, table.columns[0], Column("study", text=True), *ends]
        origins = {
            label.method: (own.method, data.name)
            for (data, own), label in zip(shared.cells, shared.labelled, strict=True)
        }
        for row in table.rows:
            method, name = origins[row[0].text]
            study = Entry(f"[{name}]({name}/report.html)")
            rows.append([Entry(shared.link), Entry(method), study, *row[1:7], row[-1]])
    caption = "What every method did, by scenario and study, in the order of the loss"
    table = Table(caption, columns, rows, heads=2, filters=(0, 1, 2))
    return [Text(what), table, Text(LOSS), Text(COLUMNS), Text(RULES)]


def _studies(studies: Sequence[StudyData]) -> list[Block]:
    names = ["seed", "pilotid", "code", "python"]
    names += [name for name in LIBRARIES if name in studies[0].about]
    columns = [
        *(Column(t, text=True) for t in ("study", "rows")),
        *(Column(t) for t in ("scenarios", "methods", "recordings", "fits")),
        *(Column("code digest" if name == "code" else name, text=True) for name in names),
    ]
    rows = [
        [
            f"[{data.name}]({data.name}/report.html)",
            f"[fits]({data.name}/{ESTIMATES}), [scores]({data.name}/{SUMMARY}), "
            f"[store]({data.name}/{KEPT})",
            str(len(data.study.names)),
            str(len(data.study.methods)),
            str(data.study.replications(data.study.names)),
            str(data.fits),
            *(data.about.get(name, NONE) for name in names),
        ]
        for data in studies
    ]
    blocks: list[Block] = [Table("What each study is of", columns, entries(rows))]
    for data in studies:
        if "mixed" in data.about:
            blocks.append(Text(f"**{data.name}: {mixed(data.about['mixed'])}**"))
        if data.study.cells:
            whole = command(data.study, data.about, data.study.names, data.name)
            blocks.append(Command(f"To make {data.name} again:", whole))
        else:
            blocks.append(Text(f"{data.name} holds no fits yet."))
    return blocks


def _methods(studies: Sequence[StudyData]) -> Table:
    titles = ("method", "study", "settings", "to type", "code")
    rows = []
    for data in studies:
        for label in data.study.methods:
            code = data.methods[label].code
            rows.append(
                [
                    label,
                    data.name,
                    f"`{shown(data.methods[label].settings)}`",
                    f"`{data.study.typed[label]}`",
                    f"of its own, digest {code}" if code else "of pilotid",
                ]
            )
    columns = [Column(title, text=True) for title in titles]
    return Table("All that defines each method", columns, entries(rows), heads=2)


def _scenarios(scenarios: Sequence[SharedScenario]) -> Table:
    titles = ("scenario", "studies", "description", "model", "truth")
    rows = [
        [
            shared.link,
            ", ".join(data.name for data in shared.studies),
            shared.entry.description,
            shared.entry.model,
            _truth(shared.entry),
        ]
        for shared in scenarios
    ]
    columns = [Column(title, text=True) for title in titles]
    return Table("What each scenario is", columns, entries(rows))


def _truth(entry: ScenarioEntry) -> str:
    if entry.population:
        return "drawn for each recording"
    values = (f"{p.parameter} {p.truth:.4g} {p.unit}" for p in entry.parameters)
    return ", ".join(value.rstrip() for value in values)
