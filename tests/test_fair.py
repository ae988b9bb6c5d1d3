"""Nobody gains by failing or objecting, nor loses by honest width; point estimators can enter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from pandas import DataFrame

from pilotid.estimate.estimate import Estimate, Outcome, failed
from pilotid.methods.fourier import Fourier
from pilotid.methods.mle_white import MLEWhite
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.report.study_tables import ranked
from pilotid.study.study import Study
from pilotid.study.table import Comparison, judge

SCENARIOS = ("nominal", "population-usual")
WIDE = 1.5  # relative standard error at which the adversaries give up


def is_wide(estimate: Estimate) -> bool:
    return bool(np.any(estimate.std_error > WIDE * np.abs(estimate.values)))


@dataclass(frozen=True)
class Never(Fourier):
    """Fails always."""

    name: ClassVar[str] = "never"

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        return failed(self.name, model, Outcome.SINGULAR, "no")


@dataclass(frozen=True)
class Shy(Fourier):
    """Fails where its errors are large."""

    name: ClassVar[str] = "shy"

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        found = super().fit(recording, model, rng)
        if found.outcome.usable and is_wide(found):
            return failed(self.name, model, Outcome.SINGULAR, "I would rather not say")
        return found


@dataclass(frozen=True)
class Picky(Fourier):
    """Objects where its errors are large."""

    name: ClassVar[str] = "picky"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        found = super().fit(recording, model, np.random.default_rng(1))
        return "not to my taste" if found.outcome.usable and is_wide(found) else None


@dataclass(frozen=True)
class Point(MLEWhite):
    """Gives values alone."""

    name: ClassVar[str] = "point"

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        found = super().fit(recording, model, rng)
        nothing = np.full_like(found.covariance, np.nan), np.full_like(found.intervals, np.nan)
        return replace(found, covariance=nothing[0], intervals=nothing[1], errors=None)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    folder: Path = tmp_path_factory.mktemp("fair")
    methods = [Fourier(), Never(), Shy(), Picky(), Point()]
    return Study(SCENARIOS, methods, 12, 3).run_in(folder, 2)


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_no_adversary_gains(study: Comparison, scenario: str) -> None:
    loss = study.of(scenario).loss
    for adversary in ("never", "shy", "picky"):
        assert loss[adversary] > 0.98 * loss["fourier"]


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_who_fails_in_more_than_a_tenth_is_listed_below_and_poor(
    study: Comparison, scenario: str
) -> None:
    order = [row.method for row in ranked(study, scenario)]
    scores = study.of(scenario)
    often = set(scores.method[scores.failures > 0.1 * scores.recordings])
    assert "never" in often
    scored = [m for m in order if np.isfinite(scores.loss[m])]
    sound = [m for m in scored if m not in often]
    assert scored[: len(sound)] == sound
    for method in often:
        assert judge(study.scored(scenario, method)).grade == "poor"


def test_a_parameter_without_a_bound_makes_no_method_useless() -> None:
    head = {"worth": 0, "n": 0, "recordings": 9, "failures": 0, "loss": 1.0, "mean_z_se": np.nan}
    rows = [{**head, "parameter": key} for key in ("all", "a", "b")]
    for ratios, grade in (((1, np.nan, 1), "efficient"), ((1, 1, np.nan), "efficient"),
                          ((1, np.nan, 9), "usable"), ((1, 9, np.nan), "usable")):  # fmt: skip
        assert judge(DataFrame(rows).assign(rmse_over_bound=ratios)).grade == grade


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_values_without_errors_have_a_rank_of_their_own(study: Comparison, scenario: str) -> None:
    point = study.of(scenario).loc["point"]
    assert point.failures <= 2
    assert np.isnan(point.loss)
    assert np.isfinite(point.rmse_over_bound)
    assert [row.method for row in ranked(study, scenario)][-1] == "point"
    assert judge(study.scored(scenario, "point")).grade == "unscored"
