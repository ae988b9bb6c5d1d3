"""Tables of a study."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np

from pilotid.estimates.estimate import Outcome
from pilotid.numbers import NONE, number, plus_minus, share, signed
from pilotid.report.content import Column, Entry, Table, entries
from pilotid.study.comparison import Cell, Comparison, Score, loss_ratio
from pilotid.study.judge import EFFICIENT, FEWEST, USABLE, judge
from pilotid.study.scores import Interval, loss_text

T = TypeVar("T")
#: A column, and what it says of a row's item.
Kind = tuple[Column, Callable[[T], str | Entry]]

VIOLATION = "violation"  # family of the scenarios that violate an assumption
RECORDER = "recorder"  # family of the scenarios whose recorder is faulty
OFF = 4.0  # claimed standard errors by which a value is wrong
#: Loss from which a cell of the matrix is darkest.
BAD = 10.0
FEW = 4  # scenarios of which the matrix shows intervals
LONGEST_WORDS = 60  # characters of a remark that a table shows
LATE = 1.0  # seconds from which a lag counts


def mark_of(loss: float) -> str:
    """The colour of a loss."""
    limits = {"good": EFFICIENT, "partly": USABLE, "poor": BAD, "bad": math.inf}
    return next((mark for mark, limit in limits.items() if loss < limit), "none")


def ranked(cells: Sequence[Cell]) -> list[Cell]:
    """Methods by their loss, behind them those without intervals, and those not applicable."""

    def place(cell: Cell) -> tuple[int, float]:
        loss, ratio = cell.overall.loss.value, cell.overall.ratio.value
        known = math.isfinite(loss)
        rest = ratio if math.isfinite(ratio) else math.inf
        return (0 if known else 1 if cell.tried else 2), loss if known else rest

    return sorted(cells, key=place)


def ranking(cells: Sequence[Cell], axis: tuple[float, float] | None = None) -> Table:
    """The methods of a scenario in the order of their loss.

    Parameters
    ----------
    cells
        What each method did.
    axis
        Ends of the axis of losses, as powers of ten; None for what shows all of them.
    """
    order = ranked(cells)
    entry, best = cells[0].scenario, order[0]
    low, high = axis or _axis([cell.overall.loss for cell in order])
    violated = entry.family in (VIOLATION, RECORDER)

    def times_best(cell: Cell) -> str:
        if not math.isfinite(cell.overall.loss.value):
            return NONE
        return "best" if cell is best else str(loss_ratio(cell, best))

    def objections(cell: Cell) -> str:
        return _of(cell.overall.objections, cell.overall.objections + cell.overall.tried)

    kinds: list[Kind[Cell]] = [
        (Column("method", text=True), lambda c: c.method),
        (Column("loss (95 %)", hint="interval score over an efficient estimator's"), _loss),
        (
            Column("", text=True, hint="logarithmic; 1 is perfect", ticks=_ticks(low, high)),
            lambda c: _whisker(c.overall.loss, low, high),
        ),
        (Column("times best", hint="ratio to the first row's loss, same recordings"), times_best),
        (Column("verdict", text=True, hint="by fixed limits, see below"), _verdict),
        (Column("bias", hint="mean error in claimed standard errors"), _largest_bias),
        (Column("coverage %", hint="of 95 % intervals, with its 95 % interval"), _coverage),
        (Column("failed", hint="in parentheses the loss of the other fits"), _failed),
        (Column("objects", hint="recordings that it objects to"), objections),
        (
            Column("warned", hint="recordings with a remark or a failure"),
            lambda c: _of(told(c), c.tried) if violated else NONE,
        ),
        (Column("lag", text=True, hint="of what varies, if certainly above 1 s"), _lags),
        (Column("s per fit", hint="median"), lambda c: number(c.seconds, 2)),
    ]
    count = max(len(cell.results) for cell in cells)
    what = "all fits of one recording" if entry.one_recording else "1 recording"
    if count > 1 and not entry.one_recording:
        what = f"{count} recordings"
    return _table(f"`{entry.name}`, {what}: methods by their loss (1: perfect)", kinds, order)


def _table(
    caption: str, kinds: Sequence[Kind[T]], items: Sequence[T], heads: int = 1, *,
    folded: bool = False,
) -> Table:  # fmt: skip
    """A row for each item; columns that say nothing of any are left out."""
    rows = entries([text(item) for _, text in kinds] for item in items)
    shown = [
        i
        for i, (column, _) in enumerate(kinds)
        if i < heads or column.ticks or any(row[i].text not in ("0", NONE) for row in rows)
    ]
    columns = [kinds[i][0] for i in shown]
    return Table(caption, columns, [[row[i] for i in shown] for row in rows], heads, folded)


def _loss(cell: Cell) -> str:
    if math.isfinite(cell.overall.loss.value):
        return str(cell.overall.loss)
    return f"rmse {number(cell.overall.ratio.value)} x bound" if cell.tried else "not applicable"


def _verdict(cell: Cell) -> Entry:
    verdict = judge(cell.scores)
    marks = {"efficient": "good", "usable": "partly", "poor": "poor"}
    return Entry(verdict.words, marks.get(verdict.grade, "none"))


def _coverage(cell: Cell) -> str:
    return share(cell.overall.coverage.value, cell.overall.coverage_interval)


def mean_loss(losses: Mapping[str, float]) -> float:
    """Geometric mean over scenarios."""
    return math.exp(float(np.mean(np.log(list(losses.values()))))) if losses else math.nan


def by_mean_loss(study: Comparison, names: Sequence[str]) -> dict[str, dict[str, float]]:
    """Losses by scenario of each method: those ranked in most scenarios first, then the best."""
    found = {}
    for method in study.methods:
        cells = {name: cell for name in names if (cell := study.at(name, method))}
        losses = {name: cell.overall.loss.value for name, cell in cells.items()}
        found[method] = {name: loss for name, loss in losses.items() if loss > 0.0}
    order = sorted(found, key=lambda m: (-len(found[m]), mean_loss(found[m]) if found[m] else 0.0))
    return {method: found[method] for method in order}


def matrices(study: Comparison, names: Sequence[str], widest: int) -> list[Table]:
    """Loss of every method in every scenario, a row a method.

    Parameters
    ----------
    study
        The study's numbers.
    names
        The scenarios.
    widest
        Number of scenarios beside one another; more have a table each so many.
    """
    if not widest:
        return [_matrix(study, names, ())]
    count = -(-len(names) // widest)
    size = -(-len(names) // count)
    return [_matrix(study, names, names[i : i + size]) for i in range(0, len(names), size)]


def _matrix(study: Comparison, names: Sequence[str], shown: Sequence[str]) -> Table:
    few, first = len(names) <= FEW, not shown or shown[0] == names[0]
    rows: list[list[str | Entry]] = []
    for method, own in by_mean_loss(study, names).items():
        worst = max(own, key=lambda name: own[name], default="")
        mean = loss_text(mean_loss(own)) if len(own) == len(names) else NONE
        row: list[str | Entry] = [method]
        if first:
            row += [mean, f"{number(own[worst], 2)} {worst}" if own else NONE]
        for name in shown:
            cell = study.at(name, method)
            loss = cell.overall.loss if cell else None
            if cell is None or loss is None:
                row.append(NONE)
            elif math.isfinite(loss.value):
                text = str(loss) if few else number(loss.value, 2)
                row.append(Entry(text, mark_of(loss.value)))
            else:
                row.append(Entry("no intervals" if cell.tried else "n/a", "none"))
        rows.append(row)
    columns = [Column("method", text=True)]
    if first:
        columns += [
            Column("mean", hint="geometric, where there is a loss in every scenario"),
            Column("worst", text=True),
        ]
    columns += [Column(f"[{name}](#{key_of(name)})") for name in shown]
    caption = f"Loss of every method in {len(names)} scenarios (1: perfect; n/a: not applicable)"
    if not first:
        caption = "Loss in further scenarios"
    return Table(caption, columns, entries(rows), upright=not few)


def key_of(name: str) -> str:
    """The target of links to a scenario, whose name may hold its settings."""
    return re.sub(r"[^\w-]+", "-", name)


def _axis(losses: Sequence[Interval]) -> tuple[float, float]:
    """Ends of a logarithmic axis, as powers of ten, that shows 1 and all values."""
    values = [loss.value for loss in losses if loss.value > 0.0]
    ends = [end for loss in losses for end in loss[1:] if end > 0.0 and math.isfinite(end)]
    low, high = min([0.8, *values, *ends]), max([2.0, *values, *ends])
    # One wild interval must not press all others together.
    high = min(high, 3.0 * max([1.0, *values]))
    return math.log10(low) - 0.02, math.log10(high) + 0.02


def place_on(axis: tuple[float, float], value: float) -> float:
    """Where a value lies on a logarithmic axis [%]."""
    low, high = axis
    return min(max(100.0 * (math.log10(value) - low) / (high - low), 0.0), 100.0)


def _ticks(low: float, high: float) -> tuple[tuple[float, str], ...]:
    """Ticks of an axis; 1 is the first, where a line is drawn."""
    values = [1.0, *(b * 10.0**p for p in range(-1, 6) for b in (1.0, 2.0, 5.0))]
    inside = [v for v in dict.fromkeys(values) if low <= math.log10(v) <= high]
    if high - low > 2.2:
        inside = [v for v in inside if math.log10(v).is_integer()]
    return tuple((round(place_on((low, high), v), 1), f"{v:g}") for v in inside)


def _whisker(loss: Interval, low: float, high: float) -> Entry:
    if not loss.value > 0.0:
        return Entry("")
    ends = (end if end > 0.0 and math.isfinite(end) else loss.value for end in loss[1:])
    value, *others = (round(place_on((low, high), x), 1) for x in (loss.value, *ends))
    return Entry("", mark_of(loss.value), (value, others[0], others[1]))


def _largest_bias(cell: Cell) -> str:
    known = [s for s in cell.scores[1:] if s.n >= FEWEST and s.z.error > 0.0]
    worst = max(known, key=lambda s: abs(s.z.value), default=None)
    return f"{worst.parameter} {plus_minus(*worst.z)}" if worst else NONE


def recorder_table(study: Comparison, names: Sequence[str]) -> Table:
    """What each method makes of faulty recorders: right, wrong and said, wrong and silent [%]."""
    rows: list[list[str]] = []
    for name in names:
        for cell in study.of(name):
            if not cell.tried:
                continue
            known = cell.numbers
            off = np.abs(known.value - known.truth) > OFF * known.std_error
            wrong = off.any(axis=1) | ~cell.counted
            said = np.array([bool(r.remarks) or not r.usable for r in cell.results])
            tried = cell.applicable
            shares = [~wrong, wrong & said, wrong & ~said]
            numbers = [f"{100.0 * np.mean(share[tried]):.0f}" for share in shares]
            rows.append([name, cell.method, str(cell.tried), *numbers])
    columns = [
        Column("recorder", text=True),
        Column("method", text=True),
        Column("n"),
        Column("right %", hint=f"no value is off by more than {OFF:g} claimed standard errors"),
        Column("wrong, said %", hint="of recording or fit there is a remark"),
        Column("wrong, silent %"),
    ]
    return Table("What faulty recorders do to each method", columns, entries(rows), 2)


def told(cell: Cell) -> int:
    """Recordings that the method can treat of which a user is told something."""
    return sum(bool(r.remarks) or not r.usable for r in cell.attempts)


def _remarks(cell: Cell) -> str:
    """The first words of the two commonest remarks, and how often they came."""
    every = [remark for r in cell.attempts for remark in r.remarks.split(" | ") if remark]
    kinds = Counter(map(_kind, every))
    common = sorted(kinds, key=lambda kind: (-kinds[kind], kind))[:2]
    return "; ".join(f"{_short(kind, every)} ({kinds[kind]})" for kind in common) or NONE


def _short(kind: str, every: Sequence[str]) -> str:
    words = next(remark for remark in every if _kind(remark) == kind)
    return (
        words if len(words) <= LONGEST_WORDS else f"{words[:LONGEST_WORDS].rsplit(' ', 1)[0]} ..."
    )


def _kind(remark: str) -> str:
    """The first words without numbers, which differ from recording to recording."""
    return " ".join(re.sub(r"[-+.e\d]*\d[-+.e\d]*", "", remark).split()[:6])


def _of(count: int, total: int) -> str:
    return f"{count} of {total}" if count else "0"


def _failed(cell: Cell) -> str:
    """Fits that failed, and the loss of the others."""
    own = cell.overall
    if not own.failures:
        return "0"
    return f"{own.failures} of {own.tried} ({number(own.loss_ended_well)})"


def remark_table(cells: Sequence[Cell]) -> Table:
    """What users of each method are told most often."""
    columns = [Column("method", text=True), Column("warned", hint="of the recordings"),
               Column("commonest remarks, and how often", text=True)]  # fmt: skip
    rows = [[c.method, _of(told(c), c.tried), _remarks(c)] for c in ranked(cells) if c.tried]
    return Table("What users are told", columns, entries(rows), folded=True)


def _lags(cell: Cell) -> str:
    """Parameters that a method follows certainly too late, or runs ahead of."""
    late = [s for s in cell.tracks if abs(s.lag) - 1.96 * s.lag_se > LATE]
    words = (
        f"{s.parameter} {number(abs(s.lag), 2)} s {'late' if s.lag > 0 else 'ahead'}" for s in late
    )
    return ", ".join(words) or ("none" if cell.tracks else NONE)


def all_numbers(cells: Sequence[Cell], paper: Sequence[tuple[float, float]] = ()) -> Table:
    """All scores of a scenario: a row for each parameter and method."""
    population, name = cells[0].scenario.population, cells[0].scenario.name
    keys = list(dict.fromkeys(key for cell in cells for key in cell.keys))
    papers = dict(zip(keys, paper, strict=bool(paper)))
    items = [
        (cell.method, cell.scores[1 + cell.keys.index(key)].percent)
        for key in keys
        for cell in cells
        if key in cell.keys and cell.tried
    ]

    def of_many(text: str) -> str:
        return text if population else NONE

    kinds: list[Kind[tuple[str, Score]]] = [
        (Column("parameter", text=True), lambda i: i[1].parameter),
        (Column("method", text=True), lambda i: i[0]),
        (Column("n", hint="values of fits that count"), lambda i: str(i[1].n)),
        (Column("loss", hint="with its 95 % interval"), lambda i: str(i[1].loss)),
        (Column("bias / claim", hint="mean standardised error"), lambda i: plus_minus(*i[1].z)),
        (Column("rmse / bound", hint="with its error"), lambda i: _unsigned(i[1].ratio)),
        (
            Column("coverage %", hint="of the 95 % intervals, with its 95 % interval"),
            lambda i: share(i[1].coverage.value, i[1].coverage_interval),
        ),
        (Column("rms", hint="of error over claim"), lambda i: of_many(_unsigned(i[1].rms))),
        (Column("trimmed", hint="by 1 %"), lambda i: of_many(_unsigned(i[1].trimmed))),
        (
            Column("beyond 3 %", hint="share of errors beyond 3 claimed errors"),
            lambda i: of_many(number(100.0 * i[1].beyond.value, 2)),
        ),
        (Column("median", hint="of error over bound"), lambda i: of_many(number(i[1].typical))),
        (
            Column("wrong optima", hint="of the fits for which it is known"),
            lambda i: f"{i[1].wrong} of {i[1].optima}" if i[1].optima else NONE,
        ),
        (Column("bias %", hint="of the true value"), lambda i: plus_minus(*i[1].bias)),
        (
            Column("paper: bias %", paper=True),
            lambda i: signed(papers[i[1].parameter][0]) if papers else NONE,
        ),
        (Column("std %", hint="standard deviation"), lambda i: _unsigned(i[1].std)),
        (
            Column("paper: std %", paper=True),
            lambda i: f"{papers[i[1].parameter][1]:g}" if papers else NONE,
        ),
        (Column("claimed %", hint="mean standard error"), lambda i: number(i[1].claimed)),
        (Column("posterior %", hint="mean spread"), lambda i: number(i[1].posterior)),
        (Column("bound %", hint="of Cramér and Rao"), lambda i: number(i[1].bound)),
    ]
    return _table(f"`{name}`: all numbers", kinds, items, 2, folded=True)


def _unsigned(score: tuple[float, float]) -> str:
    return plus_minus(*score).lstrip("+")


def bias_table(
    study: Comparison,
    scenarios: Sequence[str],
    paper: Mapping[str, Sequence[float]],
    caption: str,
) -> Table:
    """Bias in a few scenarios, a column for the paper and one for each method.

    Parameters
    ----------
    study
        The study's numbers.
    scenarios
        Their names.
    paper
        Biases [%] that the paper gives, by scenario.
    caption
        What the table shows.
    """
    columns = [
        Column("scenario", text=True),
        Column("parameter", text=True),
        Column("paper: bias %", paper=True),
        *(Column(m, hint="bias % with its Monte Carlo error") for m in study.methods),
    ]
    rows = []
    for name in scenarios:
        percent = {cell.method: cell.percent for cell in study.of(name)}
        for index, known in enumerate(study.entry(name).parameters):
            row = [name, known.parameter, signed(paper[name][index]) if name in paper else NONE]
            for method in study.methods:
                own = percent.get(method)
                row.append(plus_minus(*own[index].bias) if own else NONE)
            rows.append(row)
    return Table(caption, columns, entries(rows), heads=2)


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
            row = [known.parameter, cell.method, str(score.n), str(score.failures)]
            row += [f"{cell.agreeing} of {cell.tried}", number(middle)]
            row += [signed(paper[index])] if paper else []
            rows.append([*row, number(score.std.value), number(score.bound)])
    return Table(f"`{cells[0].scenario.name}`: ends of the search", columns, entries(rows), heads=2)


def track_table(caption: str, cells: Sequence[Cell], *, moving: bool) -> Table:
    """A row for each parameter and method, of parameters that vary or of those that stay."""
    periods = ("before %", "during %", "after %", "whole %")
    hint = "rms of relative errors with its Monte Carlo standard error"
    columns = [
        Column("parameter", text=True),
        Column("method", text=True),
        Column("n", hint="trajectories"),
        *(Column(period, hint=hint) for period in periods),
        Column("median %", hint="of the recordings' root mean squares over the whole window"),
        Column("lag s", hint="median with its Monte Carlo standard error"),
        Column("in band %", hint="share of the time, with its Monte Carlo standard error"),
    ]
    rows = []
    for key in dict.fromkeys(s.parameter for cell in cells for s in cell.tracks):
        for cell in cells:
            s = next(s for s in cell.tracks if s.parameter == key)
            if math.isfinite(s.lag) != moving:
                continue
            errors = [
                _unsigned((100.0 * value, 100.0 * error))
                for value, error in zip(s.rmse, s.rmse_se, strict=True)
            ]
            held = _unsigned((100.0 * s.coverage, 100.0 * s.coverage_se))
            lag = plus_minus(s.lag, s.lag_se) if math.isfinite(s.lag) else NONE
            rows.append(
                [s.parameter, cell.method, str(s.n), *errors, number(100.0 * s.median), lag, held]
            )
    return Table(caption, columns, entries(rows), heads=2, folded=not moving)


def failure_table(study: Comparison) -> Table:
    """Every outcome but plain convergence, with its details and how often it came."""
    columns = [Column("scenario", text=True), Column("method", text=True), Column("fits"),
               Column("of"), Column("counts as", text=True), Column("outcome", text=True),
               Column("details", text=True)]  # fmt: skip
    rows = []
    for cell in study.cells:
        counted = Counter(r.outcome for r in cell.results)
        counted.pop(Outcome.CONVERGED.slug, None)
        total = str(len(cell.results))
        rows += [
            [cell.scenario.name, cell.method, str(count), total, *_outcome(cell, outcome)]
            for outcome, count in sorted(counted.items())
        ]
    return Table("Fits that did not simply converge", columns, entries(rows), heads=2, folded=True)


def _outcome(cell: Cell, outcome: str) -> list[str]:
    known = {o.slug: o for o in Outcome}.get(outcome)
    usable = any(r.usable for r in cell.results if r.outcome == outcome)
    treated = "result" if usable else "no try" if known is Outcome.NOT_APPLICABLE else "failure"
    messages = Counter(" ".join(r.message.split()) for r in cell.results if r.outcome == outcome)
    messages.pop("", None)
    common = sorted(messages.items(), key=lambda item: (-item[1], item[0]))
    words = [f"{text} ({count})" if len(common) > 1 else text for text, count in common[:3]]
    if len(common) > 3:
        words.append(f"and {sum(count for _, count in common[3:])} more")
    return [treated, known.value if known else outcome, "; ".join(words)]
