"""The first page over several studies: methods x scenarios, and what each study is."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from pilotid.analysis.board import BOARD, Board
from pilotid.analysis.report_left_out import left_out_blocks
from pilotid.naming.settings import shown
from pilotid.numbers import NONE, number
from pilotid.publishing.beside import Beside
from pilotid.publishing.held import Held
from pilotid.report import appendix
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
)
from pilotid.report.population_verdicts import PopulationVerdict
from pilotid.report.verdicts import extremes, judge, sized
from pilotid.study.archive import KEPT
from pilotid.study.comparison import SUMMARY_COLUMNS, Cell
from pilotid.study.entries import ScenarioEntry
from pilotid.study.facts import LIBRARIES
from pilotid.study.population import PopulationCell
from pilotid.study.summary import ESTIMATES, SUMMARY

#: All scores of all studies.
SCORES = "scores.csv"
#: Columns of it before those of a study's summary.
SCORE_COLUMNS = ("study", "scenario", "method", *SUMMARY_COLUMNS)

Row = list[str | Entry]


def score_rows(studies: Sequence[Held]) -> Iterator[list[object]]:
    """`SCORE_COLUMNS` of every parameter of every method in every scenario and study."""
    for held in studies:
        for row in held.study.summary_rows():
            yield [held.name, *row]


def sections_of(studies: Sequence[Held], scenarios: Sequence[Beside]) -> list[Section]:
    """The first page's sections on simulated recordings; none without studies."""
    if not studies:
        return []
    return [
        Section("results", "Methods and scenarios", _results(studies, scenarios)),
        Section("studies", "Studies", _studies(studies)),
        Section("methods", "Methods and their settings", [_methods(studies)]),
        Section("scenarios", "Scenarios", [_scenarios(scenarios)]),
        Section("reading", "How to read the numbers", [_reading()]),
    ]


def people(boards: Mapping[str, Board]) -> Iterator[Section]:
    """Recordings of people, by the name of the analysis; the recordings themselves stay outside."""
    for name, board in boards.items():
        versions = ", ".join(f"{what} {version}" for what, version in board.versions.items())
        taken = Text(f"[All runs]({name}/{BOARD}) as a file. Versions: {versions}.")
        command = Command("To make it again, with the recordings:", board.command)
        blocks = [*left_out_blocks(board), taken, command]
        yield Section(f"people-{name}", f"Recordings of people: {name}", blocks)


def _results(studies: Sequence[Held], scenarios: Sequence[Beside]) -> list[Block]:
    fits = sum(held.fits for held in studies)
    methods = {label for held in studies for label in held.study.methods}
    what = (
        f"{_counted(len(studies), 'study', 'studies')}, {_counted(len(methods), 'method')}, "
        f"{_counted(len(scenarios), 'scenario')}, {fits} fits of simulated recordings whose truth "
        f"is known. A scenario's page has its methods side by side; [{SCORES}]({SCORES}) has every "
        "score, and each study its rows."
    )
    columns = [
        Column("scenario", text=True),
        Column("method", text=True),
        Column("study", text=True),
        Column("verdict", text=True, hint="by the rules of the study's own report"),
        Column("counted", hint="fits that count"),
        Column("of", hint="fits of recordings that the method can treat"),
        Column("bias / bound", hint="the largest over the parameters"),
        Column("rmse / bound", hint="the largest over the parameters"),
        Column("coverage %", hint="of 95 % intervals, lowest to highest over the parameters; the "
               "line reaches from 50 to 100 %, the stroke across is 95 %"),
        Column("ms per fit", hint="median"),
    ]  # fmt: skip
    rows = [row for beside in scenarios for row in _rows(beside)]
    caption = "What every method did, by scenario and study"
    table = Table(caption, columns, entries(rows), heads=2, filters=(0, 1, 2, 3))
    return [Text(what), table]


def _counted(count: int, one: str, many: str = "") -> str:
    return f"{count} {one if count == 1 else many or one + 's'}"


def _rows(beside: Beside) -> Iterator[Row]:
    for held, each in beside.attempts:
        row: Row = [beside.link, each.method, f"[{held.name}]({held.name}/report.html)"]
        if isinstance(each, Cell):
            yield row + _of_cell(held, each)
        elif isinstance(each, PopulationCell):
            yield row + _of_population(each)


def _of_cell(held: Held, cell: Cell) -> Row:
    head = [str(cell.usable), str(cell.tried)]
    if cell.scenario.one_recording:
        return [Entry("one recording", "none"), *head, NONE, NONE, NONE, number(cell.milliseconds)]
    verdict = judge(cell, held.rules)
    _, bias = extremes(sized(cell), lambda s: abs(s.bias) / s.bound)
    _, rmse = extremes(sized(cell), lambda s: s.ratio)
    low, high = extremes(cell.percent, lambda s: s.coverage)
    return [
        Entry(verdict.words, verdict.grade.value),
        *head,
        f"{number(abs(bias.bias) / bias.bound, 2)} {bias.parameter}" if bias else NONE,
        f"{number(rmse.ratio)} {rmse.parameter}" if rmse else NONE,
        _coverage(low.coverage, high.coverage) if low and high else NONE,
        number(cell.milliseconds),
    ]


def _of_population(cell: PopulationCell) -> Row:
    own, verdict = cell.overall, PopulationVerdict(cell)
    shares = [cell.standing(key).coverage.value for key in cell.keys]
    known = [share for share in shares if math.isfinite(share)]
    return [
        Entry(verdict.words, verdict.grade.value),
        str(cell.usable),
        str(own.recordings),
        NONE,
        number(own.ratio.value),
        _coverage(min(known), max(known)) if known else NONE,
        number(cell.milliseconds),
    ]


def _coverage(low: float, high: float) -> Entry:
    return Entry(f"{100.0 * low:.0f}{NONE}{100.0 * high:.0f}", reach=(low, high))


def _studies(studies: Sequence[Held]) -> list[Block]:
    names = ["seed", "pilotid", "code", "python", *_libraries(studies)]
    columns = [
        *(Column(t, text=True) for t in ("study", "rows")),
        *(Column(t) for t in ("scenarios", "methods", "recordings", "fits")),
        *(Column("code digest" if name == "code" else name, text=True) for name in names),
    ]
    rows = [
        [
            f"[{held.name}]({held.name}/report.html)",
            f"[fits]({held.name}/{ESTIMATES}), [scores]({held.name}/{SUMMARY}), "
            f"[store]({held.name}/{KEPT})",
            str(len(held.study.all_names)),
            str(len(held.study.methods)),
            str(held.study.replications(held.study.all_names)),
            str(held.fits),
            *(held.about.get(name, NONE) for name in names),
        ]
        for held in studies
    ]
    blocks: list[Block] = [Table("What each study is of", columns, entries(rows))]
    for held in studies:
        if "mixed" in held.about:
            blocks.append(Text(f"**{held.name}: {appendix.mixed(held.about['mixed'])}**"))
        if held.warning:
            blocks.append(
                Text(f"**{held.name}: was damaged; this is of the fits that are whole.**")
            )
        if held.study.every:
            whole = appendix.command(held.study, held.about, held.study.all_names, held.name)
            blocks.append(Command(f"To make {held.name} again:", whole))
        else:
            blocks.append(Text(f"{held.name} holds no fits yet."))
    return blocks


def _libraries(studies: Sequence[Held]) -> list[str]:
    """Names of the libraries whose versions studies noted."""
    first = studies[0].about
    return [name for name in LIBRARIES if name in first]


def _methods(studies: Sequence[Held]) -> Table:
    columns = [Column(t, text=True) for t in ("method", "study", "settings", "to type", "code")]
    rows = [
        [
            label,
            held.name,
            f"`{shown(held.methods[label].settings)}`",
            f"`{held.study.typed[label]}`",
            _origin(held.methods[label].code),
        ]
        for held in studies
        for label in held.study.methods
    ]
    return Table("All that defines each method", columns, entries(rows), heads=2)


def _origin(code: str) -> str:
    return f"of its own, digest {code}" if code else "of pilotid"


def _scenarios(scenarios: Sequence[Beside]) -> Table:
    columns = [
        Column(t, text=True) for t in ("scenario", "studies", "description", "model", "truth")
    ]
    rows = [
        [
            beside.link,
            ", ".join(held.name for held in beside.studies),
            beside.entry.description,
            beside.entry.model,
            _truth(beside.entry),
        ]
        for beside in scenarios
    ]
    return Table("What each scenario is", columns, entries(rows))


def _truth(entry: ScenarioEntry) -> str:
    if entry.population:
        return "drawn for each recording"
    units: Mapping[str, str] = {p.parameter: p.unit for p in entry.parameters}
    values = (f"{p.parameter} {p.truth:.4g} {units[p.parameter]}" for p in entry.parameters)
    return ", ".join(value.rstrip() for value in values)


def _reading() -> Bullets:
    items = [
        "**Bias / bound**: the mean error in units of the Cramér-Rao bound, of the parameter in "
        "which it is largest; **rmse / bound**: the same of the root mean square error. Both are "
        "over the fits that count. On a population: over all parameters.",
        "**Coverage**: share of the 95 % intervals that hold the truth, of the parameter that has "
        "the least and of the one that has the most. The line reaches from 50 to 100 %; the "
        "stroke across it is 95 %, near which an honest method lies.",
        "**Verdicts** are those of each study's own report, which has its rules: the more a "
        "report compares, the surer it must be of each.",
        "Clicking a table's heading sorts it; a third click restores its order. The fields above "
        "a table choose rows. Without JavaScript the tables are whole, in the order of the "
        "catalogues.",
        f"**{KEPT}** has all rows of a study: put it into a folder, and `pilotid report`, `pilotid "
        "publish` and `pilotid compare-studies` take the folder for the study.",
    ]
    return Bullets(items)
