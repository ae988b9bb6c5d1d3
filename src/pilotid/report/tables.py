"""Tables of a study."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pilotid.estimates.estimate import Outcome
from pilotid.numbers import NONE, number, plus_minus, printed, share, signed
from pilotid.report.content import Column, Entry, Table, entries
from pilotid.report.verdicts import Verdict, extremes, sized
from pilotid.study.attempts import Attempts
from pilotid.study.comparison import Cell, Comparison
from pilotid.study.score import Score


def verdict_table(verdicts: Sequence[Verdict], caption: str) -> Table:
    """A row for each method: the whole scenario in a few numbers."""
    missed = any(v.failures for v in verdicts)
    columns = [
        Column("method", text=True),
        Column("verdict", text=True, hint="by the rules beneath"),
        Column("failed", hint="fits that failed, of those tried"),
        Column("largest bias", text=True, hint="in multiples of the Cramér-Rao bound"),
        Column("rmse / bound", hint="median over the parameters, and the worst"),
        Column("coverage %", hint="share of 95 % intervals that hold the truth, by parameter"),
        *([Column("all fits %", hint="the same with a failed fit as a miss")] if missed else []),
        Column("claimed / real", hint="claimed standard error over standard deviation, median"),
        Column("ms per fit", hint="median"),
    ]
    return Table(caption, columns, entries(_verdict_row(v, missed=missed) for v in verdicts))


def _verdict_row(verdict: Verdict, *, missed: bool) -> list[str | Entry]:
    cell = verdict.cell
    row: list[str | Entry] = [
        cell.method,
        Entry(verdict.words, verdict.grade.value),
        f"{verdict.failures} of {cell.tried}",
        largest_bias(cell),
        worst_rmse(cell),
        span(cell, lambda s: 100.0 * s.coverage),
        *([span(cell, lambda s: 100.0 * s.coverage_all)] if missed else []),
        number(_median(cell, lambda s: s.claimed / s.std if s.std else math.nan), 2),
        number(cell.milliseconds),
    ]
    return row


def largest_bias(cell: Cell) -> str:
    """The largest bias in multiples of the bound, in % and of which parameter."""
    _, worst = extremes(sized(cell), lambda s: abs(s.bias) / s.bound)
    if worst is None:
        return NONE
    return f"{number(abs(worst.bias) / worst.bound, 2)} ({worst.parameter} {signed(worst.bias)} %)"


def worst_rmse(cell: Cell) -> str:
    """Median and largest ratio of rmse to bound."""
    _, worst = extremes(sized(cell), lambda s: s.ratio)
    if worst is None:
        return NONE
    return f"{number(_median(cell, lambda s: s.ratio))}, {number(worst.ratio)} {worst.parameter}"


def span(cell: Cell, value: Callable[[Score], float]) -> str:
    """Lowest and highest value over the parameters."""
    low, high = extremes(cell.percent, value)
    return NONE if low is None or high is None else f"{value(low):.0f}{NONE}{value(high):.0f}"


def _median(cell: Cell, value: Callable[[Score], float]) -> float:
    values = [value(s) for s in cell.percent if math.isfinite(value(s))]
    return float(np.median(values)) if values else math.nan


def matrix(
    study: Comparison, verdicts: Mapping[tuple[str, str], Entry], links: Mapping[str, str]
) -> Table:
    """The verdict on each method in each scenario and on each population."""
    rows: list[list[str | Entry]] = []
    for name in links:
        row: list[str | Entry] = [f"[{name}](#{links[name]})"]
        row += [verdicts.get((name, method), NONE) for method in study.methods]
        rows.append(row)
    columns = [Column("scenario", text=True), *(Column(m, text=True) for m in study.methods)]
    return Table("Which method to trust where", columns, entries(rows))


def scenario_table(cells: Sequence[Cell], paper: Sequence[tuple[float, float]] = ()) -> Table:
    """All numbers of a scenario: a row for each parameter and method."""
    failed = any(s.n_all != s.n or s.tried != s.n for c in cells for s in c.percent if s.tried)
    sampled = any(math.isfinite(s.posterior) for c in cells for s in c.percent)
    columns = [
        Column("parameter", text=True),
        Column("method", text=True),
        Column("n", hint="fits that count"),
        Column("failed", hint="of those tried"),
        Column("bias %", hint="with its Monte Carlo standard error"),
        *([Column("paper: bias %", paper=True)] if paper else []),
        Column("std %", hint="standard deviation with its Monte Carlo standard error"),
        *([Column("paper: std %", paper=True)] if paper else []),
        Column("claimed %", hint="mean of the standard errors that the method claims"),
        *([Column("posterior %", hint="mean spread of the posterior")] if sampled else []),
        Column("bound %", hint="Cramér-Rao bound on the standard deviation"),
        Column("rmse / bound", hint="with its Monte Carlo standard error"),
        Column("coverage %", hint="of the 95 % intervals, with its 95 % (Wilson) interval"),
    ]
    if failed:
        columns += [
            Column("all: n", hint="fits that gave values, failed or not"),
            Column("all: bias %", hint="over all fits that gave values"),
            Column("all: std %", hint="over all fits that gave values"),
            Column("all: coverage %", hint="over all fits tried, a failed one being a miss"),
        ]
    rows = []
    for index in range(len(cells[0].percent)):
        given = paper[index] if paper else None
        for cell in cells:
            score = cell.percent[index]
            rows.append(_row(score, cell.method, given, sampled=sampled, failed=failed))
    name = cells[0].scenario.name
    return Table(f"`{name}`: all numbers", columns, entries(rows), heads=2, folded=True)


def _row(
    s: Score, method: str, paper: tuple[float, float] | None, *, sampled: bool, failed: bool
) -> list[str]:
    row = [s.parameter, method, str(s.n), str(s.tried - s.n), plus_minus(s.bias, s.bias_se)]
    if paper:
        row.append(printed(paper[0]))
    row.append(plus_minus(s.std, s.std_se).lstrip("+"))
    if paper:
        row.append(f"{paper[1]:g}")
    row.append(number(s.claimed))
    if sampled:
        row.append(number(s.posterior))
    row += [
        number(s.bound),
        plus_minus(s.ratio, s.ratio_se).lstrip("+"),
        share(s.coverage, s.coverage_interval),
    ]
    if failed:
        row += [
            str(s.n_all),
            plus_minus(s.bias_all, s.bias_all_se),
            number(s.std_all),
            share(s.coverage_all, s.coverage_all_interval),
        ]
    return row


def bias_table(
    study: Comparison,
    scenarios: Sequence[tuple[str, str]],
    paper: Mapping[str, Sequence[float]],
    caption: str,
    places: int = 1,
) -> Table:
    """Bias in a few scenarios, a column for the paper and one for each method.

    Parameters
    ----------
    study
        The study's numbers.
    scenarios
        Scenarios and their short names.
    paper
        Biases [%] that the paper gives, by scenario.
    caption
        What the table shows.
    places
        Decimals of the paper's numbers.
    """
    columns = [
        Column("scenario", text=True),
        Column("parameter", text=True),
        Column("paper: bias %", paper=True),
        *(Column(m, hint="bias % with its Monte Carlo error") for m in study.methods),
    ]
    rows = []
    for name, short in scenarios:
        for index, known in enumerate(study.entry(name).parameters):
            row = [
                short,
                known.parameter,
                printed(paper[name][index], places) if name in paper else NONE,
            ]
            for method in study.methods:
                cell = study.at(name, method)
                score = cell.percent[index] if cell else None
                row.append(plus_minus(score.bias, score.bias_se) if score else NONE)
            rows.append(row)
        rows.append([short, "fits", NONE, *_fits(study, name)])
    return Table(caption, columns, entries(rows), heads=2)


def _fits(study: Comparison, scenario: str) -> list[str]:
    cells = [study.at(scenario, method) for method in study.methods]
    return [f"{c.usable} of {c.tried}" if c and c.tried else NONE for c in cells]


def starts_table(cells: Sequence[Cell], paper: Sequence[float]) -> Table:
    """Where fits of one recording end, by parameter and method."""
    columns = [
        Column("parameter", text=True),
        Column("method", text=True),
        Column("n", hint="fits that count"),
        Column("failed", hint="of those tried"),
        Column("common end", hint="starts that end within a tenth of the bound of the median end"),
        Column("error %", hint="of the median end"),
        *([Column("paper: error %", paper=True)] if paper else []),
        Column("spread %", hint="standard deviation over the starts"),
        Column("bound %", hint="Cramér-Rao bound on the standard deviation"),
    ]
    rows = []
    for index, known in enumerate(cells[0].scenario.parameters):
        for cell in cells:
            found, score = cell.errors[:, index], cell.percent[index]
            middle = float(np.median(found)) if found.size else math.nan
            row = [known.parameter, cell.method, str(score.n), str(score.tried - score.n)]
            row += [f"{cell.agreeing} of {cell.tried}", number(middle)]
            row += [signed(paper[index])] if paper else []
            rows.append([*row, number(score.std), number(score.bound)])
    return Table(f"`{cells[0].scenario.name}`: ends of the search", columns, entries(rows), heads=2)


def posterior_table(study: Comparison, scenarios: Sequence[str]) -> Table | None:
    """Posterior spread against scatter and bound, None if no method has a posterior."""
    rows = []
    for name in scenarios:
        for cell in study.of(name):
            rows += [
                [name, s.parameter, cell.method, number(s.posterior),
                 plus_minus(s.std, s.std_se).lstrip("+"), number(s.bound),
                 number(s.posterior / s.std if s.std > 0.0 else math.nan),
                 share(s.coverage, s.coverage_interval)]
                for s in cell.percent if math.isfinite(s.posterior)
            ]  # fmt: skip
    titles = ("posterior %", "std %", "bound %", "posterior / std", "coverage %")
    words = [Column(t, text=True) for t in ("scenario", "parameter", "method")]
    columns = [*words, *(Column(t) for t in titles)]
    if not rows:
        return None
    return Table("Posterior spread against scatter and bound", columns, entries(rows), heads=3)


def failure_table(study: Comparison) -> Table:
    """Every outcome but plain convergence, with its details and how often it came."""
    columns = [Column("scenario", text=True), Column("method", text=True), Column("fits"),
               Column("of"), Column("counts as", text=True), Column("outcome", text=True),
               Column("details", text=True)]  # fmt: skip
    rows = []
    for name in study.all_names:
        for cell in study.tried_on(name):
            counted = Counter(r.outcome for r in cell.results)
            counted.pop(Outcome.CONVERGED.slug, None)
            total = str(len(cell.results))
            rows += [
                [name, cell.method, str(count), total, *_outcome(cell, outcome)]
                for outcome, count in sorted(counted.items())
            ]
    return Table("Fits that did not simply converge", columns, entries(rows), heads=2)


def _outcome(cell: Attempts, outcome: str) -> list[str]:
    known = {o.slug: o for o in Outcome}.get(outcome)
    usable = any(r.usable for r in cell.results if r.outcome == outcome)
    treated = "result" if usable else "no try" if known is Outcome.NOT_APPLICABLE else "failure"
    told = (" ".join(r.message.split()) for r in cell.results if r.outcome == outcome)
    messages = Counter(message for message in told if message)
    ranked = sorted(messages.items(), key=lambda item: (-item[1], item[0]))
    words = [f"{text} ({count})" if len(ranked) > 1 else text for text, count in ranked[:3]]
    if len(ranked) > 3:
        words.append(f"and {sum(count for _, count in ranked[3:])} more")
    return [treated, known.value if known else outcome, "; ".join(words)]


def ratio_table(study: Comparison, scenarios: Sequence[str]) -> Table:
    """Root mean square error over the bound in a few scenarios, a column for each method."""
    words = [Column(t, text=True) for t in ("scenario", "parameter")]
    columns = [*words, Column("bound %"), *(Column(m) for m in study.methods)]
    rows: list[list[str]] = []
    for name in scenarios:
        for index, known in enumerate(study.entry(name).parameters):
            row = [name, known.parameter, number(study.of(name)[0].percent[index].bound)]
            for method in study.methods:
                cell = study.at(name, method)
                score = cell.percent[index] if cell else None
                row.append(plus_minus(score.ratio, score.ratio_se).lstrip("+") if score else NONE)
            rows.append(row)
        rows.append([name, "fits", NONE, *_fits(study, name)])
    return Table("Root mean square error over the bound", columns, entries(rows), heads=2)
