"""Tables of a study, and what `trust.json` says of a fit."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pilotid.estimates.estimate import Outcome
from pilotid.estimates.quantities import symbol
from pilotid.study.comparison import ALL, Comparison, MethodResults, Score, loss_ratios
from pilotid.study.judge import EFFICIENT, FEWEST, USABLE, judge
from pilotid.study.scores import Interval, loss_text
from pilotid.study.store import Result
from pilotid.study.trust import TRUST
from pilotid.support.document import Block, Bullets, Column, LogAxis, Section, Table, Text, table_of
from pilotid.support.format import NONE, number, percent, plus_minus, share, unsigned

VIOLATION = "violation"  # family of the scenarios that violate an assumption
RECORDER = "recorder"  # family of the scenarios whose recorder is faulty
OFF = 4.0  # claimed standard errors by which a value is wrong
#: Loss from which a cell of the matrix is darkest.
BAD = 10.0
FEW = 4  # scenarios of which the matrix shows intervals
LONGEST_WORDS = 60  # characters of a remark that a table shows
GRADES = {"efficient": "good", "usable": "partly", "poor": "poor"}


def loss_mark(loss: float) -> str:
    """The colour of a loss."""
    limits = {"good": EFFICIENT, "partly": USABLE, "poor": BAD, "bad": math.inf}
    return next((mark for mark, limit in limits.items() if loss < limit), "none")


def with_interval(value: float, lower: float, upper: float) -> str:
    """A loss, or a ratio of losses, with its interval."""
    return str(Interval(value, lower, upper))


def ranked(cells: Sequence[MethodResults]) -> list[MethodResults]:
    """Methods by their loss, behind them those without intervals, and those not applicable."""

    def place(cell: MethodResults) -> tuple[int, float]:
        loss, ratio = cell.overall.loss.value, cell.overall.ratio.value
        known = math.isfinite(loss)
        rest = ratio if math.isfinite(ratio) else math.inf
        return (0 if known else 1 if cell.tried else 2), loss if known else rest

    return sorted(cells, key=place)


def ranking(cells: Sequence[MethodResults]) -> Table[MethodResults]:
    """The methods of a scenario in the order of their loss."""
    order, entry = ranked(cells), cells[0].scenario
    count = max(len(cell.results) for cell in cells)
    what = "all fits of one recording" if entry.one_recording else "1 recording"
    if count > 1 and not entry.one_recording:
        what = f"{count} recordings"
    axis = LogAxis.of(cell.overall.loss for cell in order)
    caption = f"`{entry.name}`, {what}: methods by their loss "
    caption += f"(1: exact; below {EFFICIENT:g} efficient, below {USABLE:g} usable)"
    return Table(caption, _ranking_columns(order[0], axis), order)


def _ranking_columns(best: MethodResults, axis: LogAxis) -> list[Column[MethodResults]]:
    def times_best(cell: MethodResults) -> str | None:
        if not math.isfinite(cell.overall.loss.value):
            return None
        return "best" if cell is best else str(loss_ratios(cell, best)[ALL])

    return [
        Column("method", lambda c: c.method),
        Column("loss (95 %)", _loss, str, hint="interval score over an efficient estimator's"),
        Column(
            "",
            lambda c: c.overall.loss,
            hint="logarithmic; 1: exact and efficient",
            mark=lambda c: loss_mark(c.overall.loss.value),
            axis=axis,
        ),
        Column("times best", times_best, str, "ratio to the first row's loss, same recordings"),
        Column("verdict", lambda c: judge(c.scores).words, None, "by fixed limits", _grade),
        Column("largest bias/error", _largest_bias, str, "mean error, in claimed standard errors"),
        Column("coverage %", lambda c: covered(c.overall), share, "of 95 % intervals"),
        Column("failed (loss else)", _failed, str, "loss of the other fits"),
        Column("objects", _objections, of, "recordings that it objects to"),
        Column("warned", _warned_of_violation, str, "recordings with a remark or a failure"),
        Column("s per fit", lambda c: (c.seconds, 2), number, "median"),
    ]


def _loss(cell: MethodResults) -> str:
    if math.isfinite(cell.overall.loss.value):
        return str(cell.overall.loss)
    return f"rmse {number(cell.overall.ratio.value)} x bound" if cell.tried else "not applicable"


def _largest_bias(cell: MethodResults) -> str | None:
    known = [s for s in cell.scores[1:] if s.n >= FEWEST and s.z.error > 0.0]
    worst = max(known, key=lambda s: abs(s.z.value), default=None)
    return f"{worst.parameter} {plus_minus(*worst.z)}" if worst else None


def of(count: int, total: int) -> str:
    """A share as two counts."""
    return f"{count} of {total}" if count else "0"


def covered(score: Score) -> tuple[float, tuple[float, float]]:
    """Coverage with its 95 % interval."""
    return score.coverage.value, score.coverage_interval


def _grade(cell: MethodResults) -> str:
    return GRADES.get(judge(cell.scores).grade, "none")


def _objections(cell: MethodResults) -> tuple[int, int]:
    count = cell.overall.objections
    return count, count + cell.overall.tried


def _warned(cell: MethodResults) -> str:
    """Recordings that the method can treat of which a user is told something."""
    return of(sum(bool(r.remarks) or not r.usable for r in cell.attempts), cell.tried)


def _warned_of_violation(cell: MethodResults) -> str | None:
    """Warnings where an assumption is violated, or the recorder is faulty."""
    return _warned(cell) if cell.scenario.family in (VIOLATION, RECORDER) else None


def recorder_table(study: Comparison, names: Sequence[str]) -> Table[Any]:
    """What each method makes of faulty recorders."""
    whole = "{:.0f}".format
    heads = [
        *(("recorder",), ("method",), ("n",)),
        ("right %", whole, f"off by {OFF:g} errors at most"),
        ("wrong, said %", whole, "a remark or a failure"),
        ("wrong, silent %", whole),
    ]
    rows = [
        (name, cell.method, cell.tried, *(100.0 * share for share in shares_told(cell)))
        for name in names
        for cell in study.of(name)
        if cell.tried
    ]
    return table_of("What faulty recorders do to each method", heads, rows, 2)


def shares_told(cell: MethodResults) -> tuple[float, float, float]:
    """Shares of fits that are right, wrong with a word of it, and wrong in silence."""
    known, tried = cell.numbers, cell.applicable
    off = np.abs(known.value - known.truth) > OFF * known.std_error
    wrong = off.any(axis=1) | ~cell.counted
    said = np.array([bool(r.remarks) or not r.usable for r in cell.results])
    right, named, silent = (
        float(np.mean(share[tried])) for share in (~wrong, wrong & said, wrong & ~said)
    )
    return right, named, silent


def _failed(cell: MethodResults) -> str:
    """Fits that failed, and the loss of the others."""
    own = cell.overall
    return of(own.failures, own.tried) + (
        f" ({number(own.loss_ended_well)})" if own.failures else ""
    )


# ------------------------------------------------------------------------------ scenarios


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


def matrices(study: Comparison, names: Sequence[str], widest: int) -> list[Table[str]]:
    """Loss of every method in every scenario, a row a method.

    At most `widest` scenarios stand beside one another, and more have a table each so many; with
    0 the table has the means alone.
    """
    count = -(-len(names) // widest) if widest else 1
    size = -(-len(names) // count)
    few, losses = len(names) <= FEW, by_mean_loss(study, names)

    def mean(method: str) -> str | None:
        whole = len(losses[method]) == len(names)
        return loss_text(mean_loss(losses[method])) if whole else None

    def worst(method: str) -> str | None:
        loss, name = max(((v, k) for k, v in losses[method].items()), default=(0.0, ""))
        return f"{number(loss, 2)} {name}" if name else None

    def column(name: str) -> Column[str]:
        def loss(method: str) -> str | None:
            cell = study.at(name, method)
            if cell is None or math.isfinite(cell.overall.loss.value):
                own = cell.overall.loss if cell else None
                return own and (str(own) if few else number(own.value, 2))
            return "no intervals" if cell.tried else "n/a"

        def mark(method: str) -> str:
            cell = study.at(name, method)
            return loss_mark(cell.overall.loss.value) if cell else ""

        return Column(f"[{name}](#{key_of(name)})", loss, str, mark=mark)

    front: list[Column[str]] = [
        Column("mean", mean, str, "geometric, where there is a loss in every scenario"),
        Column("worst", worst),
    ]
    caption = f"Loss of every method in {len(names)} scenarios (1: exact and efficient)"
    tables = []
    for i in range(0, len(names), size):
        shown = [column(name) for name in names[i : i + size]] if widest else []
        columns: list[Column[str]] = [Column("method", str), *([] if i else front), *shown]
        title = "Loss in further scenarios" if i else caption
        tables.append(Table(title, columns, list(losses), upright=not few))
    return tables


def key_of(name: str) -> str:
    """The target of links to a scenario, whose name may hold its settings."""
    return re.sub(r"[^\w-]+", "-", name)


def remark_table(cells: Sequence[MethodResults]) -> Table[MethodResults]:
    """What users of each method are told most often."""
    columns = [
        Column("method", lambda c: c.method),
        Column("warned", _warned, str, "of the recordings"),
        Column("commonest remarks, and how often", _remarks),
    ]
    tried = [cell for cell in ranked(cells) if cell.tried]
    return Table("What users are told", columns, tried, folded=True)


def _remarks(cell: MethodResults) -> str | None:
    """The first words of the two commonest remarks, and how often they came."""
    every = [remark for r in cell.attempts for remark in r.remarks.split(" | ") if remark]
    kinds = Counter(map(_kind, every))
    first = {_kind(remark): remark for remark in reversed(every)}
    common = sorted(kinds, key=lambda kind: (-kinds[kind], kind))[:2]
    return "; ".join(f"{_short(first[kind])} ({kinds[kind]})" for kind in common) or None


def _short(words: str) -> str:
    if len(words) <= LONGEST_WORDS:
        return words
    return f"{words[:LONGEST_WORDS].rsplit(' ', 1)[0]} ..."


def _kind(remark: str) -> str:
    """The first words without numbers, which differ from recording to recording."""
    return " ".join(re.sub(r"[-+.e\d]*\d[-+.e\d]*", "", remark).split()[:6])


class Row(NamedTuple):
    """A parameter by a method in a scenario, with its scores in % of the true value."""

    cell: MethodResults
    place: int
    key: str
    score: Score


def _rows(cells: Sequence[MethodResults]) -> list[Row]:
    """All parameters, each by all methods."""
    return [
        Row(cell, place, key, cell.scores[1 + place].percent)
        for key in dict.fromkeys(key for cell in cells for key in cell.keys)
        for cell in cells
        for place, own in enumerate(cell.keys)
        if own == key and cell.tried
    ]


def all_numbers(cells: Sequence[MethodResults]) -> Table[Row]:
    """All scores of a scenario: a row for each parameter and method."""
    entry = cells[0].scenario

    def shape(title: str, name: str, hint: str, form: Callable[..., str] = unsigned) -> Column[Row]:
        """A score of the distribution of errors, which only a population has."""
        population = entry.population
        return Column(title, lambda r: getattr(r.score, name) if population else None, form, hint)

    def common_end(row: Row) -> tuple[int, int] | None:
        """How many fits of one recording end where most do."""
        return (row.cell.agreeing, row.cell.tried) if entry.one_recording else None

    columns: list[Column[Row]] = [
        Column("parameter", lambda r: r.key, symbol=symbol),
        Column("method", lambda r: r.cell.method),
        Column("n", lambda r: r.score.n, str, "values of fits that count"),
        Column("loss", lambda r: r.score.loss, with_interval, "with its 95 % interval"),
        Column("bias / claim", lambda r: r.score.z, plus_minus, "mean standardised error"),
        Column("rmse / bound", lambda r: r.score.ratio, unsigned, "with its error"),
        Column("coverage %", lambda r: covered(r.score), share, "of the 95 % intervals"),
        shape("rms", "rms", "of error over claim"),
        shape("trimmed", "trimmed", "by 1 %"),
        shape("beyond 3 %", "beyond", "share of errors beyond 3 claimed errors", percent),
        shape("median", "typical", "of error over bound", number),
        Column("wrong optima", lambda r: (r.score.wrong, r.score.optima), of, "where it is known"),
        Column("common end", common_end, of, "starts within a tenth of the bound of the median"),
        Column("bias %", lambda r: r.score.bias, plus_minus, "of the true value"),
        Column("std %", lambda r: r.score.std, unsigned, "standard deviation"),
        Column("claimed %", lambda r: r.score.claimed, number, "mean standard error"),
        Column("posterior %", lambda r: r.score.posterior, number, "mean spread"),
        Column("bound %", lambda r: r.score.bound, number, "of Cramér and Rao"),
    ]
    return Table(f"`{entry.name}`: all numbers", columns, _rows(cells), heads=2, folded=True)


def failure_table(study: Comparison) -> Table[Any]:
    """Every outcome but plain convergence, with its details and how often it came."""
    sentences = {outcome.slug: outcome.value for outcome in Outcome}
    rows = []
    for cell in study.cells:
        for outcome in sorted({r.outcome for r in cell.results} - {Outcome.CONVERGED.slug}):
            own = [r for r in cell.results if r.outcome == outcome]
            counts_as = "no try" if outcome == Outcome.NOT_APPLICABLE.slug else "failure"
            if any(r.usable for r in own):
                counts_as = "result"
            front = (cell.scenario.name, cell.method, len(own), len(cell.results), counts_as)
            rows.append((*front, sentences.get(outcome, outcome), _commonest(own)))
    heads = [
        *(("scenario",), ("method",), ("fits", str), ("of", str)),
        *(("counts as",), ("outcome",), ("details",)),
    ]
    return table_of("Fits that did not simply converge", heads, rows, 2, folded=True)


def _commonest(results: Sequence[Result]) -> str:
    """The commonest messages of fits."""
    messages = Counter(" ".join(r.message.split()) for r in results)
    messages.pop("", None)
    common = sorted(messages.items(), key=lambda item: (-item[1], item[0]))
    words = [f"{text} ({count})" if len(common) > 1 else text for text, count in common[:3]]
    if len(common) > 3:
        words.append(f"and {sum(count for _, count in common[3:])} more")
    return "; ".join(words)


def read_trust(folder: Path) -> dict[str, Any] | None:
    """The `trust.json` of a folder; None where there is none, or none that is complete."""
    try:
        told = json.loads((folder / TRUST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return told if isinstance(told, dict) and "parameters" in told else None


def trust_table(told: Mapping[str, Any]) -> Table[Any]:
    """Claimed and corrected intervals, bias and coverage of each parameter."""

    def known(held: Any) -> Any:
        if isinstance(held, list):
            return tuple(map(known, held))
        return math.nan if held is None else held

    def between(low: float, high: float) -> str:
        return f"{number(low)} to {number(high)}" if math.isfinite(low) else NONE

    parameters = [
        {name: known(value) for name, value in own.items()} for own in told["parameters"].values()
    ]
    rows = [
        (
            *(f"{p['parameter']} {p['unit']}".strip(), p["value"]),
            *(p["interval_95"], p["corrected_95"], (p["factor"], 2)),
            *(p["bias"], p["bias_claimed"], (p["coverage"], p["coverage_95"])),
        )
        for p in parameters
    ]
    heads = [
        *(("parameter",), ("value", number)),
        ("claimed 95 %", between, "as the method gives it"),
        ("corrected 95 %", between, "so that 95 % hold the truth here"),
        ("length times", number),
        ("bias", plus_minus, "mean error on simulations, with its own error"),
        ("bias / claim", plus_minus, "in claimed standard errors"),
        ("coverage %", share, "of the claimed intervals, with its 95 % interval"),
    ]
    return table_of(f"`{told['method']}` on pilots like this one, {Path(told['recording']).name}",
                    heads, rows)  # fmt: skip


def advice(told: Mapping[str, Any]) -> list[str]:
    """What to do about the intervals of the fit, in sentences."""
    sound = f"The intervals of {told['method']} cover 95 % here, within Monte Carlo error."
    return told["sentences"] or [sound]


def trust_section(told: Mapping[str, Any]) -> Section:
    """The section in front of the comparison."""
    blocks: list[Block] = [Bullets(advice(told)), trust_table(told), Text(told["unknown"])]
    return Section("trust", "What the fit is worth", blocks)
