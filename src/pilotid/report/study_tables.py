"""Tables of a study, and what `trust.json` says of a fit."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pilotid.estimate.estimate import Outcome
from pilotid.study.judge import (
    EFFICIENT,
    USABLE,
    Verdict,
    fails_often,
    is_ranked,
    judge,
    worst_parameter,
)
from pilotid.study.scores import geometric_mean, loss_text
from pilotid.study.table import Comparison
from pilotid.study.trust import TRUST
from pilotid.support.format import NONE, Columns, Table, number, plus_minus, share, table, table_of

if TYPE_CHECKING:
    from pandas import DataFrame

VIOLATION = "violation"  # family of the scenarios that violate an assumption
RECORDER = "recorder"  # family of the scenarios whose recorder is faulty
OFF = 4.0  # claimed standard errors by which a value is wrong
#: Loss from which a cell of the matrix is darkest.
BAD = 10.0
MEAN = "geometric mean"
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


def ranked(study: Comparison, name: str) -> list[Any]:
    """Scores of methods over a scenario, by their loss.

    Behind them are those that fail often, by the loss of the other fits, those without intervals,
    and those not applicable.
    """

    def place(row: Any) -> tuple[int, float]:
        known, ratio = math.isfinite(row.loss), row.rmse_over_bound
        rest = ratio if math.isfinite(ratio) else math.inf
        if known and fails_often(row):
            return 1, row.loss_ended_well
        return (0 if known else 2 if row.recordings else 3), row.loss if known else rest

    return sorted(study.of(name).itertuples(), key=place)


def loss_of(row: Any) -> tuple[float, float, float]:
    """A row's loss and its 95 % interval."""
    return row.loss, row.loss_lower, row.loss_upper


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


#: The ranking's columns: of a method's scores, the study, and the best method's scores.
RANKING: Columns = {
    "method": (lambda row, study, _: marked(study, row.method), None, "*: uses prior knowledge"),
    "loss (95 %)": (
        lambda row, *_: _loss(row),
        str,
        "interval score over an efficient estimator's",
    ),
    "times best": (
        lambda row, study, best: _times_best(study, row, best),
        str,
        "ratio to the first row's loss, same recordings",
    ),
    "verdict": (lambda row, study, _: verdict(study, row).words, None, "by fixed limits"),
    "worst parameter": (
        lambda row, study, _: worst_parameter(study.scored(row.scenario, row.method)),
        None,
        "root mean square error over the bound, and bias in % of the truth",
    ),
    "coverage %": (lambda row, *_: covered(row), share, "of 95 % intervals"),
    "failed (loss else)": (lambda row, *_: _failed(row), str, "loss of the other fits"),
    "warned": (
        lambda row, study, _: _warned_of_violation(study, row),
        str,
        "recordings with a remark or a failure",
    ),
    "s per fit": (lambda row, *_: (row.seconds, 2), number, "median"),
}


def ranking(study: Comparison, name: str) -> Ranking:
    """The methods of a scenario in the order of their loss."""
    order, entry, count = ranked(study, name), study.scenarios[name], study.replications(name)
    what = "all fits of one recording" if entry.one_recording else "1 recording"
    if count > 1 and not entry.one_recording:
        what = f"{count} recordings"
    caption = f"`{name}`, {what}: methods by their loss "
    caption += f"(1: exact; below {EFFICIENT:g} efficient, below {USABLE:g} usable)"
    axis = LogAxis.of(loss_of(row) for row in order if not fails_often(row))
    marks = {"verdict": [GRADES.get(verdict(study, row).grade, "none") for row in order]}
    shown = table_of(order, caption, RANKING, study, order[0], marks=marks)
    dots = [loss_mark(row.loss) for row in order]
    whiskers = [None if fails_often(row) else axis.whisker(*loss_of(row)) for row in order]
    return Ranking(shown, axis, whiskers, dots)


def marked(study: Comparison, method: str) -> str:
    """A method's label, with a star if it uses prior knowledge of pilots."""
    return f"{method} *" if study.methods[method].uses_prior else method


def verdict(study: Comparison, row: Any) -> Verdict:
    """What is to be thought of a method in a scenario, which a row of scores names."""
    return judge(study.scored(row.scenario, row.method))


def _times_best(study: Comparison, row: Any, best: Any) -> str | None:
    if not is_ranked(row):
        return None
    return "best" if row is best else loss_text(*study.ratio(row.scenario, row.method, best.method))


def _loss(row: Any) -> str:
    if math.isfinite(row.loss):
        often = f"fails; else {loss_text(row.loss_ended_well)}"
        return often if fails_often(row) else loss_text(*loss_of(row))
    return f"rmse {number(row.rmse_over_bound)} x bound" if row.recordings else "not applicable"


def covered(row: Any) -> tuple[float, tuple[float, float]]:
    """Coverage with its 95 % interval."""
    return row.coverage_95, (row.coverage_lower, row.coverage_upper)


def _warned_of_violation(study: Comparison, row: Any) -> str | None:
    """Warnings where an assumption is violated, or the recorder is faulty."""
    violated = study.scenarios[row.scenario].family in (VIOLATION, RECORDER)
    return of(row.warned, row.recordings) if violated else None


def recorder_table(study: Comparison, names: Sequence[str]) -> Table:
    """What each method makes of faulty recorders: fits that are right, and wrong ones."""
    titles = ["recorder", "method", "n", "right %", "wrong, said %", "wrong, silent %"]
    hints = {"right %": f"off by {OFF:g} errors at most", "wrong, said %": "a remark or a failure"}
    rows = []
    for name in names:
        for row in study.of(name).itertuples():
            fits = study.cell(name, row.method)
            fits = fits[fits.tried].assign(off=fits.error.abs() > OFF * fits.std_error)
            own = fits.groupby("replication").agg({"off": "any", "usable": "all", "warned": "all"})
            wrong = own.off | ~own.usable
            shares = [~wrong, wrong & own.warned, wrong & ~own.warned]
            if len(own):
                rows.append((name, row.method, len(own), *(100.0 * s.mean() for s in shares)))
    forms = dict.fromkeys(titles[3:], "{:.0f}".format)
    caption = "What faulty recorders do to each method"
    return table(rows, caption, titles, forms, heads=2, hints=hints)


def _failed(row: Any) -> str:
    """Fits that failed, and the loss of the others."""
    else_ = f" ({number(row.loss_ended_well)})" if row.failures else ""
    return of(row.failures, row.recordings) + else_


# ------------------------------------------------------------------------------ scenarios


def mean_loss(losses: Mapping[str, float]) -> float:
    """Geometric mean over scenarios."""
    return geometric_mean(losses.values())


def by_mean_loss(study: Comparison, names: Sequence[str]) -> dict[str, dict[str, float]]:
    """Losses by scenario of each method: those ranked in most scenarios first, then the best."""
    found: dict[str, dict[str, float]] = {method: {} for method in study.methods}
    for name in names:
        for row in study.of(name).itertuples():
            if row.loss > 0.0 and is_ranked(row):
                found[row.method][name] = row.loss
    order = sorted(found, key=lambda m: (-len(found[m]), mean_loss(found[m]) if found[m] else 0.0))
    return {method: found[method] for method in order}


def matrices(study: Comparison, names: Sequence[str], widest: int) -> list[Table]:
    """Loss of every method in every scenario, a row a method.

    At most `widest` scenarios stand beside one another, and more have a table each so many; with
    0 the table has the means alone.
    """
    few, losses = len(names) <= FEW, by_mean_loss(study, names)
    rows = {
        (row.scenario, row.method): row for name in names for row in study.of(name).itertuples()
    }

    def front(method: str) -> tuple[str, str | None, str | None]:
        own = losses[method]
        loss, name = max(((v, k) for k, v in own.items()), default=(0.0, ""))
        mean = loss_text(mean_loss(own)) if len(own) == len(names) else None
        return method, mean, f"{number(loss, 2)} {name}" if name else None

    def text(row: Any) -> str | None:
        if row is None:
            return None
        if math.isfinite(row.loss) and fails_often(row):
            return f"fails {of(row.failures, row.recordings)}"
        if math.isfinite(row.loss):
            return loss_text(*loss_of(row)) if few else number(row.loss, 2)
        return "no intervals" if row.recordings else "n/a"

    tables = []
    for begin in range(0, len(names), size_of(len(names), widest)):
        some = names[begin : begin + size_of(len(names), widest)] if widest else []
        links = {f"[{name}](#{key_of(name)})": name for name in some}
        caption = f"Loss of every method in {len(names)} scenarios (1: exact and efficient)"
        cells = {link: [rows.get((name, m)) for m in losses] for link, name in links.items()}
        marks = {
            link: [loss_mark(row.loss) if row else "" for row in own] for link, own in cells.items()
        }
        texts = zip(*(map(text, own) for own in cells.values()), strict=True) if cells else ()
        shown = list(texts) or [()] * len(losses)
        tables.append(
            table(
                [(*front(m)[: 1 if begin else 3], *t) for m, t in zip(losses, shown, strict=True)],
                "Loss in further scenarios" if begin else caption,
                ["method", *([] if begin else [MEAN, "worst"]), *links],
                dict.fromkeys((MEAN, *links), str),
                hints={MEAN: "where there is a loss in every scenario"},
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


def remark_table(study: Comparison, name: str) -> Table:
    """What users of each method are told most often."""
    return table(
        [
            (row.method, of(row.warned, row.recordings), _remarks(study.cell(name, row.method)))
            for row in ranked(study, name)
            if row.recordings
        ],
        "What users are told",
        ["method", "warned", "commonest remarks, and how often"],
        {"warned": str},
        hints={"warned": "of the recordings"},
    )


def start_table(study: Comparison, name: str) -> Table:
    """How many fits of one recording end where most do.

    That is where each parameter is within a tenth of the bound of the median, or, where a bound is
    missing, within .1 % of the truth.
    """

    def agreeing(fits: DataFrame) -> int:
        good = fits[fits.usable]
        median = good.groupby("parameter").value.transform("median")
        reach = good.bound.fillna(0.01 * good.truth.abs()) / 10.0
        near = (good.value - median).abs() <= reach
        return int(near.groupby(good.replication).all().sum())

    return table(
        [
            (row.method, (agreeing(study.cell(name, row.method)), row.recordings))
            for row in study.of(name).itertuples()
            if row.recordings
        ],
        f"`{name}`: starts that end in the common optimum",
        ["method", "common end"],
        {"common end": of},
        hints={"common end": "within a tenth of the bound of the median"},
    )


def _remarks(fits: DataFrame) -> str | None:
    """The first words of the two commonest remarks, and how often they came."""
    lines = fits.remarks[fits["first"] & fits.tried]
    every = [remark for line in lines for remark in line.split(" | ") if remark]
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
    fits = study.measured[study.measured["first"]]
    rows = []
    for (name, method), cell in fits.groupby(["scenario", "method"], sort=False):
        for outcome, own in cell[cell.outcome != Outcome.CONVERGED.slug].groupby("outcome"):
            counts_as = "failure" if own.tried.all() else "no try"
            if own.usable.any():
                counts_as = "result"
            front = (name, method, len(own), len(cell), counts_as)
            rows.append((*front, sentences.get(outcome, outcome), _commonest(own.message)))
    titles = ["scenario", "method", "fits", "of", "counts as", "outcome", "details"]
    forms = {"fits": str, "of": str}
    return table(rows, "Fits that did not simply converge", titles, forms, heads=2)


def _commonest(every: Iterable[str]) -> str:
    """The commonest messages of fits."""
    messages = Counter(" ".join(message.split()) for message in every)
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
