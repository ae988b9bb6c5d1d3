"""The loss of methods: its formula, its intervals, what it depends on, and the verdicts on it."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import rows_of
from stores import KEYS, comparison, drawn, failed, finish

from pilotid.study import scores
from pilotid.study.scores import LOSS
from pilotid.study.table import Comparison, Fit, Verdict, judge
from pilotid.support.types import FloatArray


def fits_of(errors: FloatArray, claims: float = 1.0, *, lost: Sequence[int] = ()) -> list[Fit]:
    """Fits whose errors are given in bounds, shape (fits, parameters), as their claim is."""
    fits = []
    for replication, row in enumerate(errors):
        reach = 0.1 * claims
        parts = tuple(
            (k, "s", 1.5, 0.1, v, reach, v - 1.959964 * reach, v + 1.959964 * reach)
            for k, v in zip(KEYS, (1.5 + 0.1 * row).tolist(), strict=True)
        )
        own = Fit("one", "m", replication, "converged", "", True, model="single", estimates=parts)
        fits.append(failed(own, "diverged") if replication in lost else own)
    return fits


def study_of(errors: FloatArray, claims: float = 1.0, *, lost: Sequence[int] = ()) -> Comparison:
    return comparison(fits_of(errors, claims, lost=lost))


def overall(study: Comparison) -> Any:
    return study.scores.iloc[0]


def verdict(study: Comparison) -> Verdict:
    return judge(study.scored("one", "m"))


def normal(count: int, seed: int = 1, scale: float = 1.0) -> FloatArray:
    return np.asarray(scale * np.random.default_rng(seed).normal(size=(count, len(KEYS))))


# ------------------------------------------------------------------------------ the formula


def test_the_score_is_width_and_forty_times_what_is_missed() -> None:
    ends = np.array([[1.0, 2.0], [2.0, 2.5], [0.0, 0.5]])
    found = scores.interval_score(ends[:, 0], ends[:, 1], np.array([1.5, 1.9, 1.0]))
    assert found == pytest.approx([1.0, 0.5 + 40.0 * 0.1, 0.5 + 40.0 * 0.5])


def test_an_exact_efficient_estimator_scores_4_676_bounds() -> None:
    assert pytest.approx(4.676, abs=5e-4) == scores.EFFICIENT
    z = np.linspace(-12.0, 12.0, 2_000_001)
    density = np.exp(-0.5 * z**2) / math.sqrt(2.0 * math.pi)
    score = scores.interval_score(z - scores.Z95, z + scores.Z95, np.zeros_like(z))
    moments = [np.trapezoid(density * score**power, z) for power in (1, 2)]
    assert moments[0] == pytest.approx(scores.EFFICIENT, rel=1e-6)
    variance = (moments[1] - moments[0] ** 2) / scores.EFFICIENT**2
    assert variance == pytest.approx(scores.EFFICIENT_VARIANCE, rel=1e-4)


def test_bias_scatter_and_wrong_claims_all_cost() -> None:
    exact = overall(study_of(normal(4000)))
    assert exact.loss == pytest.approx(1.0, abs=0.02)
    assert exact.loss_lower < 1.0 < exact.loss_upper
    for worse in (
        study_of(normal(4000) + 0.5),
        study_of(normal(4000, scale=1.3)),
        study_of(normal(4000), claims=0.7),
        study_of(normal(4000), claims=1.4),
    ):
        assert overall(worse).loss_lower > 1.05


def test_a_failure_is_charged_with_zero_to_twice_the_truth() -> None:
    found = overall(study_of(np.zeros((10, len(KEYS))), lost=(3, 7)))
    hit, charge = 2.0 * scores.Z95 / scores.EFFICIENT, 2.0 * 1.5 / (scores.EFFICIENT * 0.1)
    assert found.loss == pytest.approx(0.8 * hit + 0.2 * charge)
    assert found.loss_ended_well == pytest.approx(hit)
    assert found.failures == 2


def test_standard_errors_stand_in_for_intervals_and_without_both_there_is_no_loss() -> None:
    def without(*kept: int) -> Comparison:
        return comparison(
            replace(fit, estimates=tuple(
                tuple(x if i in kept else None for i, x in enumerate(row)) for row in fit.estimates
            ))
            for fit in fits
        )  # fmt: skip

    fits = fits_of(normal(50))
    whole, bare, mute = (overall(without(*range(n))) for n in (8, 6, 5))
    assert bare[[*LOSS]].tolist() == pytest.approx(whole[[*LOSS]].tolist())
    assert math.isnan(mute.loss)
    assert mute.rmse_over_bound == pytest.approx(whole.rmse_over_bound)
    assert verdict(without(*range(5))).grade == "unscored"


def test_an_objection_to_all_recordings_is_no_try_and_to_some_a_failure() -> None:
    fits = fits_of(normal(20))
    refused = [failed(fit, "not-applicable") for fit in fits]
    assert verdict(comparison(refused)).grade == "not applicable"
    mixed = overall(comparison([*fits[:15], *refused[15:]]))
    lost = overall(comparison([*fits[:15], *(failed(fit) for fit in fits[15:])]))
    assert mixed[[*LOSS]].tolist() == lost[[*LOSS]].tolist()
    assert (mixed.not_applicable, mixed.recordings, mixed.failures) == (0, 20, 5)


def test_no_interval_is_charged_beyond_zero_and_twice_the_truth() -> None:
    wide = overall(study_of(normal(20), claims=100.0))
    assert wide.loss == pytest.approx(3.0 / (0.1 * scores.EFFICIENT))
    never = overall(study_of(normal(20), lost=range(20)))
    assert never.loss == pytest.approx(wide.loss)


# ---------------------------------------------------------------------------- the intervals


@pytest.mark.parametrize("count", [25, pytest.param(100, marks=pytest.mark.long)])
@pytest.mark.parametrize("correlation", [0.0, 0.5])
def test_intervals_of_the_loss_cover(count: int, correlation: float) -> None:
    rng = np.random.default_rng(8)
    mix = np.linalg.cholesky(correlation + (1.0 - correlation) * np.eye(7))
    studies = 300
    held = 0
    for study in range(studies):
        z = rng.normal(size=(count, 7)) @ mix.T
        score = scores.interval_score(z - scores.Z95, z + scores.Z95, np.zeros_like(z))
        _, low, high = scores.mean_losses(score / scores.EFFICIENT, str(study))[0]
        held += low <= 1.0 <= high
    assert 0.90 <= held / studies <= 0.995


def test_intervals_of_a_ratio_cover_and_are_narrower_for_the_same_recordings() -> None:
    rng = np.random.default_rng(9)
    held = 0
    for study in range(300):
        common = rng.normal(size=(50, 7))
        z = [common + 0.3 * rng.normal(size=common.shape) for _ in range(2)]
        reach = scores.Z95 * math.hypot(1.0, 0.3)
        losses = [scores.interval_score(own - reach, own + reach, 0.0 * own) for own in z]
        _, low, high = scores.mean_losses(losses[0], str(study), losses[1])[0]
        held += low <= 1.0 <= high
    assert 0.90 <= held / 300 <= 0.995
    _, lower, upper = scores.mean_losses(losses[0], "one")[0]
    assert high / low < upper / lower


def test_one_recording_has_a_loss_without_an_interval() -> None:
    found = overall(study_of(normal(1)))
    assert found.loss > 0.0
    assert math.isnan(found.loss_lower)


# ------------------------------------------------------------------------------- the tables


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    with finish(tmp_path_factory.mktemp("study"), 30) as store:
        return store.comparison()


def test_losses_agree_with_those_computed_from_the_estimates(
    study: Comparison, tmp_path: Path
) -> None:
    """By plain loops over the file that users get, with none of the package's functions."""
    study.write(tmp_path)
    found: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    for row in rows_of(tmp_path / "estimates.csv"):
        truth, bound = float(row["truth"]), float(row["crlb"])
        score = 2.0 * truth
        if row["outcome"] == "converged":
            low, high = float(row["lower_95"]), float(row["upper_95"])
            low, high = (min(max(end, 0.0), 2.0 * truth) for end in (low, high))
            score = high - low + 40.0 * max(low - truth, truth - high, 0.0)
        found[row["scenario"], row["method"], row["parameter"]].append(score / (4.675606 * bound))
    means = {key: sum(own) / len(own) for key, own in found.items()}
    seen = 0
    for row in rows_of(tmp_path / "summary.csv"):
        place = row["scenario"], row["method"]
        if row["parameter"] == "all":
            own = [mean for key, mean in means.items() if key[:2] == place]
            expected = math.exp(sum(map(math.log, own)) / len(own))
        else:
            expected = means[*place, row["parameter"]]
        assert float(row["loss"]) == pytest.approx(expected, rel=1e-6)
        assert float(row["loss_lower"]) <= float(row["loss"]) <= float(row["loss_upper"])
        seen += 1
    assert seen == 9 * (len(KEYS) + 1)
    whole = {
        (r["scenario"], r["method"], r["parameter"]): r["loss"]
        for r in rows_of(tmp_path / "population.csv")
        if r["stratum"] == "all"
    }
    for row in rows_of(tmp_path / "summary.csv"):
        if row["scenario"] == "any":
            assert whole[row["scenario"], row["method"], row["parameter"]] == row["loss"]


def test_other_methods_and_scenarios_leave_a_row_as_it_is(
    study: Comparison, tmp_path: Path
) -> None:
    study.write(tmp_path)
    whole = (tmp_path / "summary.csv").read_text().splitlines()
    parts = (tmp_path / "population.csv").read_text().splitlines()
    for column, value in (("method", "arx"), ("scenario", "any")):
        alone = tmp_path / "alone"
        alone.mkdir(exist_ok=True)
        part = replace(study, frame=study.frame[study.frame[column] == value])
        part.write(alone)
        assert set((alone / "summary.csv").read_text().splitlines()) < set(whole)
        if column == "scenario":
            assert (alone / "population.csv").read_text().splitlines() == parts
        for row in part.scores[["scenario", "method"]].drop_duplicates().itertuples(index=False):
            assert judge(part.scored(*row)) == judge(study.scored(*row))


def test_a_pilot_that_nobody_could_name_is_charged_by_its_draw() -> None:
    own = drawn(("any", "m", 0), np.random.default_rng(1))
    (row,) = comparison([failed(own, "died")], population=True).scores[1:2].itertuples()
    truth = own.estimates[0][2]
    assert row.loss == pytest.approx(2.0 * truth / (scores.EFFICIENT * 0.1))


# ----------------------------------------------------------------------------- the verdicts


@pytest.mark.parametrize(
    ("shift", "claims", "grade", "codes"),
    [
        (0.0, 1.0, "efficient", []),
        (0.0, 1.6, "usable", ["too-long"]),
        (0.0, 0.6, "usable", ["too-short"]),
        (4.0, 1.0, "usable", ["biased", "too-short"]),  # of one parameter of five
    ],
)
def test_verdicts(shift: float, claims: float, grade: str, codes: Sequence[str]) -> None:
    errors = normal(400)
    errors[:, 2] += shift
    found = verdict(study_of(errors, claims))
    assert found.grade == grade
    assert [flag.code for flag in found.flags] == codes
    if shift:
        assert {flag.parameter for flag in found.flags} == {KEYS[2]}
        assert found.flags[0].value == pytest.approx(4.0, abs=0.3)


def test_a_method_that_errs_everywhere_is_poor_and_one_that_fails_is_flagged() -> None:
    assert verdict(study_of(normal(100) + 4.0)).grade == "poor"
    found = verdict(study_of(normal(100), lost=range(20)))
    assert [(flag.code, flag.value) for flag in found.flags] == [("fails", 0.2)]
    assert not verdict(study_of(normal(100), lost=range(3))).flags
