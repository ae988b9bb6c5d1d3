"""Studies of populations: every replication has a pilot, a truth and a bound of its own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from helpers import rows_of
from pandas import DataFrame

import pilotid
from pilotid.datasets import POPULATIONS, simulate
from pilotid.datasets.bounds import bounds
from pilotid.datasets.experiments import experiment_of
from pilotid.estimate.estimate import Estimate, Outcome, symmetric_intervals
from pilotid.methods.mle_white import MLEWhite
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.study.run import Task, element_kind, facts_of, scenario_of, truths_of
from pilotid.study.scores import parameters_of, strata_of
from pilotid.study.study import Study
from pilotid.study.table import Fit, Store, read_study
from pilotid.support.numbers import draw_rng, fit_rng, recording_rng
from pilotid.support.types import FloatArray

#: Short recordings of one run, so that a study of them takes seconds.
QUICK = replace(
    POPULATIONS["population-usual"],
    name="quick",
    models=("single", "rate"),
    intervals=(0.02,),
    durations=(30.0, 40.0),
    runs=(1,),
)
SEED, COUNT = 4, 6


@dataclass(frozen=True)
class Fake:
    """Says that every parameter is 1; its criterion is far off where the model has 5 of them."""

    name: ClassVar[str] = "fake"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        return None

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        assert recording.source == "simulation quick"  # all that a method learns of its origin
        values = np.ones(len(model.keys))
        covariance = np.diag(values)
        intervals = symmetric_intervals(values, covariance)
        return Estimate(self.name, model, Outcome.CONVERGED, values, covariance, intervals)

    def criteria_from(
        self, recording: Recording, model: PilotModel, sets: FloatArray
    ) -> FloatArray:
        # The study alone knows the truth.
        assert sets.shape == (2, len(model.keys))
        assert np.all(sets[0] == 1.0)
        assert not np.allclose(sets[1], model.start)
        return np.array([105.0 if len(model.keys) == 5 else 101.0, 100.0])


STUDY = Study([QUICK], [MLEWhite(), Fake()], COUNT, SEED)


def run(folder: Path, study: Study = STUDY, workers: int = 2) -> dict[str, bytes]:
    """The tables of a study run to its end, without what time it took."""
    study.run_in(folder, workers).write(folder)
    return {name: (folder / name).read_bytes() for name in ("summary.csv", "population.csv")}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    run(folder)
    return folder


def score_of(folder: Path, method: str, key: str = "all") -> Any:
    scores = read_study(folder).scored("quick", method)
    return scores.set_index("parameter").loc[key]


def fits_of(folder: Path, method: str) -> list[Fit]:
    with Store(folder) as store:
        return [fit for fit in store.fits() if fit.method == method]


@pytest.mark.long
def test_any_number_of_workers_and_any_stop_give_the_same_bytes(
    finished: Path, tmp_path: Path
) -> None:
    files = {name: (finished / name).read_bytes() for name in ("summary.csv", "population.csv")}
    assert run(tmp_path / "one", workers=1) == files
    grown = tmp_path / "grown"
    run(grown, Study([QUICK], [Fake()], 2, SEED))
    assert run(grown) == files


def test_every_replication_has_its_own_truth_and_bound_and_all_methods_the_same(
    finished: Path,
) -> None:
    for fits in zip(*(fits_of(finished, m) for m in STUDY.labels), strict=True):
        scenario = QUICK.drawn(draw_rng(SEED, "quick", fits[0].replication))
        bound = np.sqrt(np.diag(bounds(experiment_of(scenario)).full))
        for fit in fits:
            keys, _, truth, own, *_ = zip(*fit.estimates, strict=True)
            assert (keys, truth) == (scenario.model.keys, scenario.truth)
            assert own == pytest.approx(bound.tolist())
            assert (fit.model, fit.facts) == (scenario.model.name, facts_of(scenario))
    assert {fit.model for fit in fits_of(finished, "fake")} == {"single", "rate"}


def test_a_method_gets_the_recording_of_its_replication(finished: Path) -> None:
    scenario = QUICK.drawn(draw_rng(SEED, "quick", 2))
    recording = simulate(scenario, recording_rng(SEED, "quick", 2))
    rng = fit_rng(SEED, "mle-white", "quick", 2)
    own = pilotid.identify(MLEWhite(), recording, scenario.model, rng)
    stored = fits_of(finished, "mle-white")[2]
    assert own.outcome.slug == stored.outcome
    assert own.values == pytest.approx([row[4] for row in stored.estimates], rel=1e-6)


def test_scores_are_in_units_of_the_claim_and_of_the_bound(finished: Path) -> None:
    errors: dict[str, list[float]] = {}
    ratios = []
    for fit in fits_of(finished, "fake"):
        for key, _, truth, bound, *_ in fit.estimates:
            errors.setdefault(key, []).append(1.0 - truth)
            ratios.append((1.0 - truth) / bound)
    keys = parameters_of(read_study(finished).cell("quick", "fake"))
    assert keys == ["Kvis", "tlead", "tdvis", "Km", "tdm", "fnm", "dnm"]
    for key in ("Kvis", "Km"):
        standing = score_of(finished, "fake", key)
        assert standing.n == len(errors[key])
        assert standing.mean_z == pytest.approx(np.mean(errors[key]))  # it claims 1
        inside = np.abs(errors[key]) <= 1.959964
        assert standing.coverage_95 == pytest.approx(np.mean(inside))
    overall = score_of(finished, "fake")
    assert overall.n == len(ratios)
    assert overall.rmse_over_bound == pytest.approx(np.sqrt(np.mean(np.square(ratios))))
    # fnm is 6.5 rad/s or more, which is not 1 within 3.
    assert score_of(finished, "fake", "fnm").beyond_3 == 1.0


@pytest.mark.long
def test_wrong_optima_are_found_by_the_study(finished: Path, tmp_path: Path) -> None:
    fake, white = score_of(finished, "fake"), score_of(finished, "mle-white")
    models = Counter(fit.model for fit in fits_of(finished, "fake"))
    assert (fake.wrong_optima, fake.optima) == (models["single"], COUNT)
    assert {fit.excess for fit in fits_of(finished, "fake")} == {5.0, 1.0}
    assert (white.wrong_optima, white.optima) == (0, 0)  # it has no such search
    # On a scenario with one truth nobody asks for it.
    ordinary = replace(pilotid.SCENARIOS["single"], name="quick", duration=30.0)
    Study([ordinary], [Fake()], 1, SEED).run_in(tmp_path / "other", 1)
    assert [fit.excess for fit in fits_of(tmp_path / "other", "fake")] == [None]


def test_strata_and_parameters_stand_in_the_table(finished: Path) -> None:
    table = rows_of(finished / "population.csv")
    own = [r for r in table if r["method"] == "fake" and r["parameter"] == "all"]
    assert {r["stratum"] for r in own} >= {"all", "model", "element", "remnant", "level", "rate"}
    for stratum in {r["stratum"] for r in own}:
        parts = [r for r in own if r["stratum"] == stratum]
        assert sum(int(r["recordings"]) for r in parts) == COUNT, stratum
        assert sum(int(r["n"]) for r in parts) == int(own[0]["n"])
    levels = dict.fromkeys(float(r["value"].split()[0]) for r in own if r["stratum"] == "level")
    assert list(levels) == sorted(levels)
    (single,) = (r for r in own if r["value"] == "single")
    assert single["wrong_optima"] == single["recordings"]
    assert all(r["wrong_optima"] == "" for r in table if r["method"] == "mle-white")
    assert {r["loss"] != "" for r in own} == {True}
    whole = [r for r in table if (r["method"], r["stratum"]) == ("fake", "all")]
    assert [r["parameter"] for r in whole[1:]] == [
        "Kvis", "tlead", "tdvis", "Km", "tdm", "fnm", "dnm"
    ]  # fmt: skip


def test_the_summary_leaves_empty_what_needs_one_truth(finished: Path) -> None:
    for row in rows_of(finished / "summary.csv"):
        assert row["scenario"] == "quick"
        for column in ("truth", "bias", "bias_se", "bias_percent", "std", "rmse", "crlb"):
            assert row[column] == ""
        assert int(row["n"]) + int(row["failures"]) <= COUNT
        assert row["n"] == "0" or 0.0 <= float(row["coverage_95"]) <= 1.0


def test_a_fit_whose_process_died_is_charged_by_its_own_pilot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def die(run: object, tasks: Iterable[Task], *_: object) -> Iterator[Fit]:
        return (Fit(*task.key, "died", "signal SIGKILL") for task in tasks)

    monkeypatch.setattr("pilotid.study.study.run_tasks", die)
    Study([QUICK], ["mle-white"], 2, SEED).run_in(tmp_path, 1)
    for fit in fits_of(tmp_path, "mle-white"):
        known = truths_of(scenario_of(QUICK, SEED, fit.replication))
        assert fit.estimates == tuple((*own, None, None, None, None) for own in known)
    assert score_of(tmp_path, "mle-white").loss > 0.0


def test_what_is_drawn_depends_on_seed_name_and_replication_alone() -> None:
    first, again = scenario_of(QUICK, 1, 3), scenario_of(replace(QUICK), 1, 3)
    assert first == again
    others = [
        scenario_of(*key)
        for key in ((QUICK, 2, 3), (QUICK, 1, 4), (replace(QUICK, name="q"), 1, 3))
    ]
    assert len({s.truth for s in (first, *others)}) == 4
    nominal = pilotid.SCENARIOS["nominal"]
    assert scenario_of(nominal, 1, 3) == nominal
    for scenario in (scenario_of(POPULATIONS["population-usual"], 1, r) for r in range(12)):
        assert element_kind(scenario.element) in (
            "K", "K/s", "K/s^2", "K/(s(s+a))", "second order"
        )  # fmt: skip


def test_a_pilot_of_a_population_can_be_simulated() -> None:
    first, again = (pilotid.simulate("population-usual", 5) for _ in range(2))
    np.testing.assert_array_equal(first.u, again.u)
    scenario = POPULATIONS["population-usual"].drawn(draw_rng(5, "population-usual"))
    own = simulate(scenario, recording_rng(5, "population-usual"))
    np.testing.assert_array_equal(first.u, own.u)
    rng = np.random.default_rng(1)
    assert pilotid.simulate("population-short", rng).u.size > 0


def test_strata_hold_every_recording_once() -> None:
    frame = DataFrame({
        "replication": range(9),
        "model": ["rate" if r % 3 else "multi" for r in range(9)],
        "remnant_level": np.linspace(0.05, 0.3, 9),
        "duration": 30.0 + 1e-15 * np.arange(9),
        "dt": [0.02 if r < 4 else 0.005 for r in range(9)],
    }).assign(element="K", remnant=None, forcing=None, runs=1.0, run_in=0.0)  # fmt: skip
    strata = strata_of(frame)
    for name, labels in strata.items():
        assert list(labels.index) == list(range(9)), name
        assert labels.notna().all(), name
    assert list(strata["model"]) == ["multi", "rate", "rate"] * 3
    assert list(strata["rate"]) == ["50 Hz"] * 4 + ["200 Hz"] * 5
    assert set(strata["length"]) == {"30 to 30 s"}
    assert list(strata["level"].value_counts()) == [3, 3, 3]
    assert strata["level"][0] == "5 to 13 %"
    assert not len(strata_of(frame[:0])["level"])
