"""Tables of a study, and what `trust.json` says of a fit."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pilotid.estimates.estimate import Outcome
from pilotid.study.comparison import ALL, Comparison, MethodResults, Score, loss_ratios
from pilotid.study.judge import EFFICIENT, FEWEST, USABLE, judge
from pilotid.study.scores import loss_text
from pilotid.study.store import Result
from pilotid.study.trust import TRUST
from pilotid.support.format import NONE, Columns, Table, number, plus_minus, share, table, table_of

VIOLATION = "violation"  # family of the scenarios that violate an assumption
RECORDER = "recorder"  # family of the scenarios whose recorder is faulty
OFF = 4.0  # claimed standard errors by which a value is wrong
#: Loss from which a cell of the matrix is darkest.
BAD = 10.0
FEW = 4  # scenarios of which the matrix shows intervals
LONGEST_WORDS = 60  # characters of a remark that a table shows
GRADES = {"efficient": "good", "usable": "partly", "poor": "poor"}


class LogAxis(NamedTuple):
    """A logarithmic axis of dots and whiskers; its ends as powers of ten."""

    low: float
    high: float

    @classmethod
    def of(cls, intervals: Iterable[tuple[float, float, float]]) -> LogAxis:
        """An axis that shows 1 and all values with their lower and upper ends."""
        known = [each for each in intervals if each[0] > 0.0]
        values = [value for value, *_ in known]
        ends = [end for _, *own in known for end in own if end > 0.0 and math.isfinite(end)]
        low, high = min([0.8, *values, *ends]), max([2.0, *values, *ends])
        # One wild interval must not press all others together.
        high = min(high, 3.0 * max([1.0, *values]))
        return cls(math.log10(low) - 0.02, math.log10(high) + 0.02)

    def place(self, value: float) -> float:
        """Where a value lies [%]."""
        share = (math.log10(value) - self.low) / (self.high - self.low)
        return round(min(max(100.0 * share, 0.0), 100.0), 1)

    def whisker(self, value: float, lower: float, upper: float) -> tuple[float, ...] | None:
        """Places of a value and of the ends of its interval [%]; None without a value."""
        if not value > 0.0:
            return None
        ends = (end if end > 0.0 and math.isfinite(end) else value for end in (lower, upper))
        return tuple(map(self.place, (value, *ends)))

    @property
    def ticks(self) -> list[tuple[float, str]]:
        """Places [%] and labels."""
        values = [base * 10.0**power for power in range(-1, 6) for base in (1.0, 2.0, 5.0)]
        inside = [v for v in values if self.low <= math.log10(v) <= self.high]
        if self.high - self.low > 2.2:
            inside = [v for v in inside if math.log10(v).is_integer()]
        return [(self.place(v), f"{v:g}") for v in inside]


def loss_mark(loss: float) -> str:
    """The colour of a loss."""
    limits = {"good": EFFICIENT, "partly": USABLE, "poor": BAD, "bad": math.inf}
    return next((mark for mark, limit in limits.items() if loss < limit), "none")


def ranked(cells: Sequence[MethodResults]) -> list[MethodResults]:
    """Methods by their loss, behind them those without intervals, and those not applicable."""

    def place(cell: MethodResults) -> tuple[int, float]:
        loss, ratio = cell.overall.loss.value, cell.overall.ratio.value
        known = math.isfinite(loss)
        rest = ratio if math.isfinite(ratio) else math.inf
        return (0 if known else 1 if cell.tried else 2), loss if known else rest

    return sorted(cells, key=place)


def of(count: int, total: int) -> str:
    """A share as two counts."""
    return f"{count} of {total}" if count else "0"


class Ranking(NamedTuple):
    """A table of methods, with what a page draws of their losses: axis, dots and whiskers.

    Attributes
    ----------
    table
        The table.
    axis, whiskers, dots
        The axis, the places of value and interval on it, and their colours.
    """

    table: Table
    axis: LogAxis
    whiskers: Sequence[tuple[float, ...] | None]
    dots: Sequence[str]


#: The ranking's columns, of a method and of the best one.
RANKING: Columns = {
    "method": (lambda c, _: c.method, None, ""),
    "loss (95 %)": (lambda c, _: _loss(c), str, "interval score over an efficient estimator's"),
    "times best": (
        lambda c, best: _times_best(c, best),
        str,
        "ratio to the first row's loss, same recordings",
    ),
    "verdict": (lambda c, _: judge(c.scores).words, None, "by fixed limits"),
    "largest bias/error": (
        lambda c, _: _largest_bias(c),
        str,
        "mean error, in claimed standard errors",
    ),
    "coverage %": (lambda c, _: covered(c.overall), share, "of 95 % intervals"),
    "failed (loss else)": (lambda c, _: _failed(c), str, "loss of the other fits"),
    "objects": (lambda c, _: _objections(c), of, "recordings that it objects to"),
    "warned": (
        lambda c, _: _warned_of_violation(c),
        str,
        "recordings with a remark or a failure",
    ),
    "s per fit": (lambda c, _: (c.seconds, 2), number, "median"),
}


def ranking(cells: Sequence[MethodResults]) -> Ranking:
    """The methods of a scenario in the order of their loss."""
    order, entry = ranked(cells), cells[0].scenario
    count = max(len(cell.results) for cell in cells)
    what = "all fits of one recording" if entry.one_recording else "1 recording"
    if count > 1 and not entry.one_recording:
        what = f"{count} recordings"
    caption = f"`{entry.name}`, {what}: methods by their loss "
    caption += f"(1: exact; below {EFFICIENT:g} efficient, below {USABLE:g} usable)"
    losses = [cell.overall.loss for cell in order]
    axis = LogAxis.of(losses)
    verdicts = [GRADES.get(judge(cell.scores).grade, "none") for cell in order]
    shown = table_of(order, caption, RANKING, order[0], marks={"verdict": verdicts})
    dots = [loss_mark(loss.value) for loss in losses]
    return Ranking(shown, axis, [axis.whisker(*loss) for loss in losses], dots)


def _times_best(cell: MethodResults, best: MethodResults) -> str | None:
    if not math.isfinite(cell.overall.loss.value):
        return None
    return "best" if cell is best else str(loss_ratios(cell, best)[ALL])


def _loss(cell: MethodResults) -> str:
    if math.isfinite(cell.overall.loss.value):
        return str(cell.overall.loss)
    return f"rmse {number(cell.overall.ratio.value)} x bound" if cell.tried else "not applicable"


def _largest_bias(cell: MethodResults) -> str | None:
    known = [s for s in cell.scores[1:] if s.n >= FEWEST and s.z.error > 0.0]
    worst = max(known, key=lambda s: abs(s.z.value), default=None)
    return f"{worst.parameter} {plus_minus(*worst.z)}" if worst else None


def covered(score: Score) -> tuple[float, tuple[float, float]]:
    """Coverage with its 95 % interval."""
    return score.coverage.value, score.coverage_interval


def _objections(cell: MethodResults) -> tuple[int, int]:
    count = cell.overall.objections
    return count, count + cell.overall.tried


def _warned(cell: MethodResults) -> str:
    """Recordings that the method can treat of which a user is told something."""
    return of(sum(bool(r.remarks) or not r.usable for r in cell.attempts), cell.tried)


def _warned_of_violation(cell: MethodResults) -> str | None:
    """Warnings where an assumption is violated, or the recorder is faulty."""
    return _warned(cell) if cell.scenario.family in (VIOLATION, RECORDER) else None


def recorder_table(study: Comparison, names: Sequence[str]) -> Table:
    """What each method makes of faulty recorders."""
    titles = ["recorder", "method", "n", "right %", "wrong, said %", "wrong, silent %"]
    hints = {"right %": f"off by {OFF:g} errors at most", "wrong, said %": "a remark or a failure"}
    rows = [
        (name, cell.method, cell.tried, *(100.0 * share for share in shares_told(cell)))
        for name in names
        for cell in study.of(name)
        if cell.tried
    ]
    forms = dict.fromkeys(titles[3:], "{:.0f}".format)
    caption = "What faulty recorders do to each method"
    return table(rows, caption, titles, forms, heads=2, hints=hints)


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


def matrices(study: Comparison, names: Sequence[str], widest: int) -> list[Table]:
    """Loss of every method in every scenario, a row a method.

    At most `widest` scenarios stand beside one another, and more have a table each so many; with
    0 the table has the means alone.
    """
    few, losses = len(names) <= FEW, by_mean_loss(study, names)

    def front(method: str) -> tuple[str, str | None, str | None]:
        own = losses[method]
        loss, name = max(((v, k) for k, v in own.items()), default=(0.0, ""))
        mean = loss_text(mean_loss(own)) if len(own) == len(names) else None
        return method, mean, f"{number(loss, 2)} {name}" if name else None

    def text(cell: MethodResults | None) -> str | None:
        if cell is None or math.isfinite(cell.overall.loss.value):
            own = cell.overall.loss if cell else None
            return own and (str(own) if few else number(own.value, 2))
        return "no intervals" if cell.tried else "n/a"

    tables = []
    for begin in range(0, len(names), size_of(len(names), widest)):
        some = names[begin : begin + size_of(len(names), widest)] if widest else []
        links = [f"[{name}](#{key_of(name)})" for name in some]
        cells = {m: [study.at(name, m) for name in some] for m in losses}
        caption = f"Loss of every method in {len(names)} scenarios (1: exact and efficient)"
        marks = {
            link: [
                loss_mark(cell.overall.loss.value) if (cell := own[i]) else ""
                for own in cells.values()
            ]
            for i, link in enumerate(links)
        }
        tables.append(
            table(
                [(*front(m)[: 1 if begin else 3], *map(text, own)) for m, own in cells.items()],
                "Loss in further scenarios" if begin else caption,
                ["method", *([] if begin else ["mean", "worst"]), *links],
                dict.fromkeys(("mean", *links), str),
                hints={"mean": "geometric, where there is a loss in every scenario"},
                marks=marks,
            )
        )
    return tables


def size_of(count: int, widest: int) -> int:
    """How many scenarios stand beside one another, so that tables are equally wide."""
    return -(-count // -(-count // widest)) if widest else count


def key_of(name: str) -> str:
    """The target of links to a scenario, whose name may hold its settings."""
    return re.sub(r"[^\w-]+", "-", name)


def remark_table(cells: Sequence[MethodResults]) -> Table:
    """What users of each method are told most often."""
    return table(
        [(cell.method, _warned(cell), _remarks(cell)) for cell in ranked(cells) if cell.tried],
        "What users are told",
        ["method", "warned", "commonest remarks, and how often"],
        {"warned": str},
        hints={"warned": "of the recordings"},
    )


def start_table(cells: Sequence[MethodResults]) -> Table:
    """How many fits of one recording end where most do."""
    return table(
        [(cell.method, (cell.agreeing, cell.tried)) for cell in cells if cell.tried],
        f"`{cells[0].scenario.name}`: starts that end in the common optimum",
        ["method", "common end"],
        {"common end": of},
        hints={"common end": "within a tenth of the bound of the median"},
    )


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


def failure_table(study: Comparison) -> Table:
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
    titles = ["scenario", "method", "fits", "of", "counts as", "outcome", "details"]
    forms = {"fits": str, "of": str}
    return table(rows, "Fits that did not simply converge", titles, forms, heads=2)


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


def trust_table(told: Mapping[str, Any]) -> Table:
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
    columns: Columns = {
        "parameter": (lambda p: p["parameter"], None, ""),
        "unit": (lambda p: p["unit"], None, ""),
        "value": (lambda p: p["value"], number, ""),
        "claimed 95 %": (lambda p: p["interval_95"], between, "as the method gives it"),
        "corrected 95 %": (
            lambda p: p["corrected_95"],
            between,
            "so that 95 % hold the truth here",
        ),
        "length times": (lambda p: (p["factor"], 2), number, ""),
        "bias": (lambda p: p["bias"], plus_minus, "mean error on simulations, with its own error"),
        "bias / claim": (lambda p: p["bias_claimed"], plus_minus, "in claimed standard errors"),
        "coverage %": (
            lambda p: (p["coverage"], p["coverage_95"]),
            share,
            "of the claimed intervals, with its 95 % interval",
        ),
    }
    caption = f"`{told['method']}` on pilots like this one, {Path(told['recording']).name}"
    return table_of(parameters, caption, columns)


def advice(told: Mapping[str, Any]) -> list[str]:
    """What to do about the intervals of the fit, in sentences."""
    sound = f"The intervals of {told['method']} cover 95 % here, within Monte Carlo error."
    return told["sentences"] or [sound]
