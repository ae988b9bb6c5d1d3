"""Tables of a study, and of what `trust.json` says of a fit."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pilotid.estimate.estimate import Outcome
from pilotid.study.scores import geometric_mean, loss_text
from pilotid.study.table import (
    EFFICIENT,
    USABLE,
    Comparison,
    fails_often,
    is_ranked,
    judge,
    worst_parameter,
)
from pilotid.study.trust import TRUST
from pilotid.support.format import NONE, Table, number, plus_minus, share, table

#: Families of scenarios in which a warning is due: an assumption is violated, a recorder is faulty.
WARNED = ("violation", "recorder")
#: Loss from which a cell of the matrix is darkest.
BAD = 10.0
GRADES = {"efficient": "good", "usable": "partly", "poor": "poor"}


def loss_mark(loss: float) -> str:
    """The colour of a loss."""
    limits = {"good": EFFICIENT, "partly": USABLE, "poor": BAD, "bad": math.inf}
    return next((mark for mark, limit in limits.items() if loss < limit), "none")


def ranked(study: Comparison, name: str) -> list[Any]:
    """Scores of methods over a scenario, by their loss.

    Behind them are those that fail often, by the loss of the other fits, those without intervals,
    and those not applicable.
    """

    def order(row: Any) -> tuple[int, float]:
        known, ratio = math.isfinite(row.loss), row.rmse_over_bound
        rest = ratio if math.isfinite(ratio) else math.inf
        if known and fails_often(row):
            return 1, row.loss_ended_well
        return (0 if known else 2 if row.recordings else 3), row.loss if known else rest

    return sorted(study.of(name).itertuples(), key=order)


def loss_of(row: Any) -> tuple[float, float, float]:
    """A row's loss and its 95 % interval."""
    return row.loss, row.loss_lower, row.loss_upper


def of(count: int, total: int) -> str:
    """A share as two counts."""
    return f"{count} of {total}" if count else "0"


#: The ranking's columns by title: what writes a value as a number, None for words.
RANKING: Mapping[str, Callable[..., str] | None] = {
    "method": None,
    "loss (95 %)": str,
    "times best": str,
    "verdict": None,
    "worst parameter": None,
    "coverage %": share,
    "failed": str,
    "warned": str,
    "s per fit": number,
}


def ranking(study: Comparison, name: str) -> Table:
    """The methods of a scenario in the order of their loss."""
    order, count, rows, marks = ranked(study, name), study.replications(name), [], []
    warned = study.scenarios[name].family in WARNED
    for row in order:
        scored = study.scored(name, row.method)
        verdict = judge(scored)
        marks.append(GRADES.get(verdict.grade, "none"))
        rows.append([
            f"{row.method}{' *' * study.methods[row.method].uses_prior}",
            _loss(row),
            _times_best(study, row, order[0]),
            verdict.words,
            worst_parameter(scored),
            (row.coverage_95, (row.coverage_lower, row.coverage_upper)),
            of(row.failures, row.recordings),
            of(row.warned, row.recordings) if warned else None,
            (row.seconds, 2),
        ])  # fmt: skip
    what = "1 recording" if count == 1 else f"{count} recordings"
    caption = f"`{name}`, {what}: methods by their loss "
    caption += f"(1: exact; below {EFFICIENT:g} efficient, below {USABLE:g} usable)"
    forms = {title: form for title, form in RANKING.items() if form}
    return table(rows, caption, [*RANKING], forms, marks={"verdict": marks})


def _times_best(study: Comparison, row: Any, best: Any) -> str | None:
    if not is_ranked(row):
        return None
    return "best" if row is best else loss_text(*study.ratio(row.scenario, row.method, best.method))


def _loss(row: Any) -> str:
    if math.isfinite(row.loss):
        often = f"fails; else {loss_text(row.loss_ended_well)}"
        return often if fails_often(row) else loss_text(*loss_of(row))
    return f"rmse {number(row.rmse_over_bound)} x bound" if row.recordings else "not applicable"


# ------------------------------------------------------------------------------ scenarios


def matrix(study: Comparison, names: Sequence[str]) -> Table:
    """Loss of every method in every scenario, a row a scenario, and the geometric means.

    Methods with a loss in most scenarios come first, then those with the least mean.
    """
    rows = {(row.scenario, row.method): row for n in names for row in study.of(n).itertuples()}
    losses: dict[str, list[float]] = {method: [] for method in study.methods}
    for (_, method), row in rows.items():
        if row.loss > 0.0 and is_ranked(row):
            losses[method].append(row.loss)
    means = {method: geometric_mean(loss) for method, loss in losses.items()}
    order = sorted(losses, key=lambda m: (-len(losses[m]), means[m] if losses[m] else 0.0))

    def text(row: Any) -> str | None:
        if row is None:
            return None
        if math.isfinite(row.loss):
            return "fails" if fails_often(row) else loss_text(row.loss)
        return "no intervals" if row.recordings else "n/a"

    common = [loss_text(means[m]) if len(losses[m]) == len(names) else None for m in order]
    shown: list[tuple[str | None, ...]] = [("geometric mean", *common)]
    shown += [(f"[{n}](#{key_of(n)})", *(text(rows.get((n, m))) for m in order)) for n in names]
    cells = {m: [rows.get((n, m)) for n in names] for m in order}
    marks = {m: ["", *(loss_mark(r.loss) if r else "" for r in loss)] for m, loss in cells.items()}
    caption = f"Loss of every method in {len(names)} scenarios (1: exact and efficient)"
    return table(shown, caption, ("scenario", *order), dict.fromkeys(order, str), marks=marks)


def key_of(name: str) -> str:
    """The target of links to a scenario, whose name may hold its settings."""
    return re.sub(r"[^\w-]+", "-", name)


def failure_table(study: Comparison) -> Table:
    """Every outcome but plain convergence, with its commonest reason and how often it came."""
    sentences = {outcome.slug: outcome.value for outcome in Outcome}
    fits = study.measured[study.measured["first"]]
    rows = []
    for (name, method), cell in fits.groupby(["scenario", "method"], sort=False):
        for outcome, lost in cell[cell.outcome != Outcome.CONVERGED.slug].groupby("outcome"):
            count = of(len(lost), len(cell))
            rows.append((name, method, count, sentences.get(outcome, outcome), _why(lost.message)))
    titles = ("scenario", "method", "fits", "outcome", "commonest reason")
    return table(rows, "Fits that did not simply converge", titles, {"fits": str}, heads=2)


def _why(messages: Iterable[str]) -> str:
    """The commonest message of fits, and how often it came."""
    counts = Counter(" ".join(message.split()) for message in messages)
    text, count = min(counts.items(), key=lambda item: (-item[1], item[0]))
    return f"{text} ({count})" if len(counts) > 1 else text


# ---------------------------------------------------------------------------------- trust


def read_trust(folder: Path) -> dict[str, Any] | None:
    """The `trust.json` of a folder; None where there is none, or none that is complete."""
    try:
        trust = json.loads((folder / TRUST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return trust if isinstance(trust, dict) and "parameters" in trust else None


def trust_table(trust: Mapping[str, Any]) -> Table:
    """Claimed and corrected intervals, bias and coverage of each parameter."""

    def known(values: Iterable[float | None]) -> tuple[float, ...]:
        return tuple(math.nan if value is None else value for value in values)

    def between(low: float, high: float) -> str:
        return f"{number(low)} to {number(high)}" if math.isfinite(low) else NONE

    rows = [
        (
            *(p["parameter"], p["unit"], p["value"]),
            *map(known, (p["interval_95"], p["corrected_95"], p["bias_claimed"])),
            (*known([p["coverage"]]), known(p["coverage_95"])),
        )
        for p in trust["parameters"].values()
    ]
    forms: dict[str, Callable[..., str]] = {
        "value": number,
        "claimed 95 %": between,
        "corrected 95 %": between,
        "bias / claim": plus_minus,
        "coverage %": share,
    }
    caption = f"`{trust['method']}` on pilots like this one, {Path(trust['recording']).name}"
    return table(rows, caption, ("parameter", "unit", *forms), forms)


def advice(trust: Mapping[str, Any]) -> list[str]:
    """What to do about the intervals of the fit, in sentences."""
    sound = f"Nothing speaks against its 95 % intervals in {trust['replications']} simulations."
    return trust["sentences"] or [sound]
