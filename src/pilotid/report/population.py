"""The chapter on populations: what methods do with any pilot, loop, remnant and recording."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from pilotid.numbers import NONE, number, plus_minus, share
from pilotid.report.chapters import Chapter
from pilotid.report.content import Block, Bullets, Column, Entry, Picture, Table, Text, entries
from pilotid.report.population_figures import by_parameter, by_stratum
from pilotid.report.population_verdicts import FEWEST, RULES, PopulationVerdict
from pilotid.study.comparison import Comparison
from pilotid.study.population import ALL, WRONG, PopulationCell
from pilotid.study.standardised import Share

if TYPE_CHECKING:
    from rich.table import Table as RichTable

KEY = "any-pilot"
TEXT = (
    "Every recording is of another pilot, drawn at random with the loop, the forcing functions, "
    "the remnant, the sampling rate, the length and the number of runs; all methods have the "
    "same recordings. Errors are therefore told in units of what the fit claims and of that "
    "recording's own Cramér-Rao bound. **Error / claim** is the root mean square of error over "
    "claimed standard error, with the largest 1 % left out: .96 for an honest method, more for "
    "one that claims too much. **rmse / bound** is the root mean square of error over bound; "
    "behind it stands the same of the median, which a few wild fits leave as it is. The "
    "parameters of a recording depend on one another, and so Monte Carlo errors are those of "
    f"recordings. A **wrong optimum** has a criterion more than {WRONG:g} above that of a search "
    "which starts at the truth; the study looks for it behind the method's back. A recording that "
    "a method objects to is no try. `population.csv` has all numbers, by stratum and parameter."
)


def names_of(study: Comparison) -> tuple[str, ...]:
    """The populations that have fits, in the order of the catalogue."""
    return tuple(dict.fromkeys(cell.scenario.name for cell in study.populations))


def cells_of(study: Comparison, name: str) -> list[PopulationCell]:
    """What methods did on a population, in the order of the methods."""
    found = {cell.method: cell for cell in study.populations if cell.scenario.name == name}
    return [found[method] for method in study.methods if method in found]


def population_chapters(study: Comparison) -> list[Chapter]:
    """The chapter on populations; nothing if the study has none."""
    names = names_of(study)
    if not names:
        return []
    blocks = [block for name in names for block in _blocks(cells_of(study, name))]
    return [Chapter(KEY, "Any pilot", TEXT, names, [*blocks, Text(f"Rules: {RULES}")], ())]


def _blocks(cells: Sequence[PopulationCell]) -> list[Block]:
    entry = cells[0].scenario
    blocks: list[Block] = [
        Text(f"**`{entry.name}`**: {entry.description}; models {entry.model}."),
        overview(cells),
    ]
    weak = [words for cell in cells if (words := _weakest(cell))]
    if weak:
        blocks.append(Bullets(weak))
    shown = [cell for cell in cells if cell.values.recording.size]
    if shown:
        blocks += [
            Picture.of(
                by_stratum(shown),
                f"coverage-{entry.name}",
                f"Coverage of 95 % intervals by part of {entry.name} and method",
                f"`{entry.name}`: share of the 95 % intervals that hold the truth, over all "
                "parameters, in parts of the recordings. Bars: 95 % Monte Carlo intervals; grey: "
                "93.5 to 96.5 %; a hollow triangle marks a share to the left of the axis.",
            ),
            Picture.of(
                by_parameter(shown),
                f"errors-{entry.name}",
                f"Quantiles of standardised errors in {entry.name} by parameter and method",
                f"`{entry.name}`: error over claimed error in ascending order, against the "
                "quantiles of a normal distribution, where an honest method lies on the line. "
                "Grey: where 95 % of each quantile would lie for as many recordings.",
            ),
        ]
    return [*blocks, _all_numbers(cells)]


def overview(cells: Sequence[PopulationCell]) -> Table:
    """A row for each method: the whole population in a few numbers."""
    columns = [
        Column("method", text=True),
        Column("verdict", text=True, hint="by the rules at the end of the chapter"),
        Column("recordings", hint="that the method accepts"),
        Column("failed", hint="fits that failed, of those tried"),
        Column("wrong optima", hint="of the fits for which it is known"),
        Column("coverage %", hint="of the 95 % intervals, with its 95 % interval"),
        Column("error / claim", hint="root mean square, 1 % trimmed"),
        Column("rmse / bound", hint="and its counterpart of the median"),
        Column("ms per fit", hint="median"),
    ]
    rows = [_overview_row(cell) for cell in cells]
    name = cells[0].scenario.name
    return Table(f"`{name}`: methods with any pilot", columns, entries(rows))


def _overview_row(cell: PopulationCell) -> list[str | Entry]:
    own, verdict = cell.overall, PopulationVerdict(cell)
    return [
        cell.method,
        Entry(verdict.words, verdict.grade.value),
        f"{own.recordings} of {own.recordings + own.objections}",
        f"{own.failures} of {own.recordings}",
        f"{own.wrong} of {own.optima}" if own.optima else NONE,
        share(own.coverage.value, own.coverage_interval),
        _with_error(own.trimmed),
        f"{_with_error(own.ratio)}, {number(own.typical)}",
        number(cell.milliseconds),
    ]


def _weakest(cell: PopulationCell) -> str:
    """The part of a population where a method covers least, in words."""
    found = []
    for name, stratum in cell.strata.items():
        for value, members in stratum.items():
            own = cell.standing(ALL, members)
            fits = own.recordings - own.failures
            if len(stratum) > 1 and fits >= FEWEST and math.isfinite(own.coverage.value):
                found.append((own.coverage.value, f"{name} {value}", own, fits))
    if not found:
        return ""
    _, where, own, fits = min(found, key=lambda each: each[:2])
    covered = share(own.coverage.value, own.coverage_interval)
    return f"`{cell.method}` covers least in: {where}, {covered} % in {fits} fits."


def _all_numbers(cells: Sequence[PopulationCell]) -> Table:
    """All scores by parameter and method."""
    columns = [
        Column("parameter", text=True),
        Column("method", text=True),
        Column("n", hint="fits that count"),
        Column("coverage %", hint="of the 95 % intervals, with its 95 % interval"),
        Column("mean", hint="of error over claimed error, with its Monte Carlo standard error"),
        Column("rms", hint="of error over claimed error"),
        Column("trimmed", hint="the same without the largest 1 %"),
        Column("beyond 3 %", hint="share of errors beyond 3 claimed errors"),
        Column("rmse / bound", hint="root mean square of error over bound"),
        Column("median", hint="median error over bound, over that of a normal variable"),
    ]
    keys = dict.fromkeys(key for cell in cells for key in cell.keys)
    rows = []
    for key in (*keys, ALL):
        for cell in cells:
            s = cell.standing(key)
            rows.append(
                [key, cell.method, str(s.n), share(s.coverage.value, s.coverage_interval),
                 plus_minus(s.mean.value, s.mean.error), _with_error(s.rms),
                 _with_error(s.trimmed), number(100.0 * s.beyond.value, 2),
                 _with_error(s.ratio), number(s.typical)]
            )  # fmt: skip
    name = cells[0].scenario.name
    return Table(f"`{name}`: all numbers", columns, entries(rows), heads=2, folded=True)


def _with_error(score: Share) -> str:
    return plus_minus(score.value, score.error).lstrip("+")


def overview_table(study: Comparison) -> RichTable:
    """The summary of all populations as a table for the terminal."""
    from pilotid.terminal import make_table

    table = make_table()
    table.title, table.title_justify, table.title_style = "any pilot", "left", ""
    for title in ("population", "method", "verdict"):
        table.add_column(title)
    for title in ("fits", "coverage %", "error/claim", "rmse/bound", "ms/fit"):
        table.add_column(title, justify="right")
    for cell in study.populations:
        own = cell.overall
        row = (
            cell.scenario.name,
            cell.method,
            PopulationVerdict(cell).words,
            f"{cell.usable}/{cell.tried}",
            share(own.coverage.value, own.coverage_interval),
            number(own.trimmed.value),
            number(own.ratio.value),
            number(cell.milliseconds),
        )
        table.add_row(*(text.replace(NONE, "-") for text in row))  # a terminal may lack the sign
    return table


def links_of(study: Comparison) -> Mapping[str, str]:
    """Where each population is told of."""
    return dict.fromkeys(names_of(study), KEY)
