"""Leave-one-run-out cross-validation: how well the fit of the other runs predicts each run.

No truth is known of people.  What can be held against an estimate is a run that it has not seen:
how much of its control the simulated response explains (VAF), and how likely it is under the
pilot and a model of the remnant that are known from the other runs.  The remnant's model is
chosen the same way for all methods, from what each of them leaves of the other runs, so that
methods without one can be judged too.  The likelihood is of the whole control: in a closed loop
the inverse of the controlled element predicts it well without being a pilot, which the VAF
shows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from pilotid.estimate.method import Method, identify
from pilotid.experiment.files import alone, without
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.recording.windows import of_runs
from pilotid.support.numbers import fit_rng

if TYPE_CHECKING:
    from pandas import DataFrame

HALVES = ("halves_percent", "halves_z")


def predict_left_out(
    recording: Recording, model: PilotModel, methods: Mapping[str, Method], run: int, seed: int
) -> list[dict[str, object]]:
    """Fit all runs but one by each method, and hold that one against the fits.

    Parameters
    ----------
    recording
        A recording of two runs at least.
    model, methods, seed
        What is fitted, methods by their labels.
    run
        The run that is left out, from 1.

    Returns
    -------
    Plain objects, one for each method.  Those of the first run have how far the fits of the odd
    and of the even runs are apart: the median over parameters in % of their mean, and the root
    mean square in the errors that both claim, which is 1 where these are right.
    """
    others, left = without(recording, run), alone(recording, run)
    found: list[dict[str, object]] = []
    for label, method in methods.items():
        estimate = identify(method, others, model, fit_rng(seed, label))
        usable = estimate.outcome.usable
        score = estimate.score(left, others) if usable else None
        row = {
            "model": model.name,
            "method": label,
            "outcome": estimate.outcome.slug,
            "vaf": score.vaf if score else math.nan,
            "log_likelihood": score.log_score if score else math.nan,
            "seconds": estimate.seconds,
        }
        found.append(row | (_halves(recording, model, method, label, seed) if run == 1 else {}))
    return found


def _halves(
    recording: Recording, model: PilotModel, method: Method, label: str, seed: int
) -> dict[str, float]:
    """How far the fits of odd and even runs are apart, in % of their mean and in claimed errors."""
    first, second = (
        identify(method, of_runs(recording, runs, "half of the runs"), model, fit_rng(seed, label))
        for runs in (range(1, recording.runs + 1, 2), range(2, recording.runs + 1, 2))
    )
    if not (first.outcome.usable and second.outcome.usable):
        return {}
    difference, size = first.values - second.values, np.abs(first.values + second.values)
    error = np.hypot(first.std_error, second.std_error)
    with np.errstate(divide="ignore", invalid="ignore"):
        percent = 200.0 * np.median(np.abs(difference) / size)
        z = np.sqrt(np.mean((difference / error) ** 2))
    return dict(zip(HALVES, (float(percent), float(z)), strict=True))


def ranked(left: DataFrame) -> DataFrame:
    """Models and methods by the likelihood of runs left out, the best first.

    Methods whose fits fail in more than half of the runs come last and are not compared run by
    run, so that they do not cost the others theirs.

    Parameters
    ----------
    left
        Rows of left_out.csv of recordings of one kind.

    Returns
    -------
    DataFrame
        By model and method ``runs`` and ``failed`` fits; ``vaf_mean`` and ``behind``, the mean
        log-likelihood of a run less that of the best, over the runs that all predict, each with its
        standard error; and the medians over recordings of how far halves are apart.
    """
    table = left.pivot(
        index=["file", "run"], columns=["model", "method"], values="log_likelihood"
    ).astype(float)
    able = table[table.columns[2 * table.count() >= len(table)]].dropna()
    groups = left.groupby(["model", "method"], sort=False)
    found = groups["vaf"].agg(["size", "count", "mean", "sem"])
    found.columns = ["runs", "failed", "vaf_mean", "vaf_error"]
    found["failed"] = found["runs"] - found["failed"]
    found[[*HALVES]] = groups[[*HALVES]].median()
    if able.size:
        best = able.sum().idxmax()
        apart = able.sub(able[best], axis=0)
        found["behind"], found["behind_error"] = apart.mean(), apart.sem()
        found.loc[[best], "behind_error"] = math.nan
    else:
        found["behind"] = found["behind_error"] = math.nan
    return found.sort_values("behind", ascending=False, na_position="last").reset_index()
