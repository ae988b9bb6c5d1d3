"""Studies of populations: every replication has a pilot, a truth and a bound of its own."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

import pilotid
from pilotid.bounds import bounds
from pilotid.datasets import POPULATIONS, simulate
from pilotid.datasets.experiments import experiment_of
from pilotid.estimates.estimate import Estimate, Outcome, symmetric_intervals
from pilotid.methods.mle_white import MLEWhite
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.study.comparison import Comparison, MethodResults, Score, comparison_of
from pilotid.study.fits import Task, element_kind, facts_of, scenario_of
from pilotid.study.store import Draw, Result, Store, strata_of
from pilotid.study.study import Study
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
    objects: bool = False

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        return "not five" if self.objects and len(model.keys) != 5 else None

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


@dataclass(frozen=True)
class Spy(MLEWhite):
    """Refuses to fit if anything that it is handed is the truth."""

    name: ClassVar[str] = "spy"

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        for replication in range(COUNT):
            scenario = QUICK.drawn(draw_rng(SEED, QUICK.name, replication))
            held = (*model.start, *(v for v in vars(recording).values() if np.ndim(v) == 0))
            assert not set(scenario.truth) & {x for x in held if isinstance(x, float)}
        return super().fit(recording, model, rng)


@dataclass(frozen=True)
class Dies(Fake):
    """A search from the truth that raises costs no fit."""

    name: ClassVar[str] = "dies"

    def criteria_from(
        self, recording: Recording, model: PilotModel, sets: FloatArray
    ) -> FloatArray:
        raise ValueError("no such start")


STUDY = Study([QUICK], [MLEWhite(), Fake(), Fake(objects=True)], COUNT, SEED)
OBJECTS = "fake(objects=true)"


def run(folder: Path, study: Study = STUDY, workers: int = 2) -> dict[str, bytes]:
    """The tables of a study run to its end, without what time it took."""
    folder.mkdir(exist_ok=True)
    with Store(folder, create=True) as store:
        for _ in study.run(store, study.enter(store), workers):
            pass
        comparison_of(store).write_tables(folder)
    return {name: (folder / name).read_bytes() for name in ("summary.csv", "population.csv")}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    run(folder)
    return folder


def held(folder: Path) -> Comparison:
    with Store(folder) as store:
        return comparison_of(store)


def score_of(cell: MethodResults, key: str) -> Score:
    return next(score for score in cell.scores if score.parameter == key)


def results_of(folder: Path, method: str) -> list[Result]:
    (cell,) = (c for c in held(folder).populations if c.method == method)
    return list(cell.results)


def rows(folder: Path, name: str) -> list[dict[str, str]]:
    with (folder / name).open(newline="") as stream:
        return list(csv.DictReader(stream))


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
    for results in zip(*(results_of(finished, m) for m in STUDY.labels), strict=True):
        replication = results[0].unit.replication
        scenario = QUICK.drawn(draw_rng(SEED, "quick", replication))
        bound = np.sqrt(np.diag(bounds(experiment_of(scenario)).full))
        for result in results:
            assert result.draw is not None
            assert result.draw.model == scenario.model.name
            assert tuple(p.truth for p in result.draw.parameters) == scenario.truth
            assert [p.bound for p in result.draw.parameters] == pytest.approx(bound.tolist())
            assert result.draw.facts == facts_of(scenario)
            keys = tuple(key for key, *_ in result.estimates)
            assert keys in (scenario.model.keys, ())
    models = {r.draw.model for r in results_of(finished, "fake") if r.draw}
    assert models == {"single", "rate"}
    for row in rows(finished, "estimates.csv"):
        truth = dict(zip(*_truth(int(row["replication"])), strict=True))
        assert float(row["truth"]) == truth[row["parameter"]]


def _truth(replication: int) -> tuple[tuple[str, ...], tuple[float, ...]]:
    scenario = QUICK.drawn(draw_rng(SEED, "quick", replication))
    return scenario.model.keys, scenario.truth


def test_a_method_gets_the_recording_of_its_replication_and_nothing_of_the_truth(
    finished: Path, tmp_path: Path
) -> None:
    run(tmp_path, Study([QUICK], [Spy()], COUNT, SEED))
    assert {r.message for r in results_of(tmp_path, "spy") if r.outcome == "crashed"} == set()
    scenario = QUICK.drawn(draw_rng(SEED, "quick", 2))
    recording = simulate(scenario, recording_rng(SEED, "quick", 2))
    rng = fit_rng(SEED, "mle-white", "quick", 2)
    own = pilotid.identify(MLEWhite(), recording, scenario.model, rng)
    stored = results_of(finished, "mle-white")[2]
    assert own.outcome.slug == stored.outcome
    assert own.values == pytest.approx([value for _, value, *_ in stored.estimates], rel=1e-6)


def test_objections_are_counted_apart_from_failures(finished: Path) -> None:
    (cell,) = (c for c in held(finished).populations if c.method == OBJECTS)
    models = Counter(r.draw.model for r in cell.results if r.draw)
    overall = cell.overall
    assert 0 < overall.objections == models["rate"] < COUNT
    assert overall.tried == cell.tried == models["single"]
    assert overall.failures == 0
    assert overall.n == 5 * models["single"]
    one = score_of(cell, "Km")
    assert (one.tried, one.objections, one.n) == (0, models["rate"], 0)
    assert math.isnan(one.coverage.value)


def test_scores_are_in_units_of_the_claim_and_of_the_bound(finished: Path) -> None:
    (cell,) = (c for c in held(finished).populations if c.method == "fake")
    errors = {key: [] for key in ("Kvis", "Km")}
    ratios = []
    for result in cell.results:
        assert result.draw is not None
        for p in result.draw.parameters:
            errors.setdefault(p.parameter, []).append(1.0 - p.truth)
            ratios.append((1.0 - p.truth) / (p.bound or math.nan))
    assert cell.keys == ("Kvis", "tlead", "tdvis", "Km", "tdm", "fnm", "dnm")
    for key in ("Kvis", "Km"):
        standing = score_of(cell, key)
        assert standing.n == len(errors[key])
        assert standing.z.value == pytest.approx(np.mean(errors[key]))  # it claims 1
        inside = np.abs(errors[key]) <= 1.959964
        assert standing.coverage.value == pytest.approx(np.mean(inside))
    overall = cell.overall
    assert overall.n == len(ratios)
    assert overall.ratio.value == pytest.approx(np.sqrt(np.mean(np.square(ratios))))
    # fnm is 6.5 rad/s or more, which is not 1 within 3.
    assert score_of(cell, "fnm").beyond.value == 1.0


@pytest.mark.long
def test_wrong_optima_are_found_by_the_study(finished: Path, tmp_path: Path) -> None:
    cells = {c.method: c for c in held(finished).populations}
    models = Counter(r.draw.model for r in cells["fake"].results if r.draw)
    overall = cells["fake"].overall
    assert (overall.wrong, overall.optima) == (models["single"], COUNT)
    assert {r.excess for r in cells["fake"].results} == {5.0, 1.0}
    white = cells["mle-white"].overall
    assert (white.wrong, white.optima) == (0, 0)  # it has no such search
    run(tmp_path, Study([QUICK], [Dies()], 2, SEED))
    assert [(r.outcome, r.excess) for r in results_of(tmp_path, "dies")] == [
        ("converged", None)
    ] * 2
    # On a scenario with one truth nobody asks for it.
    ordinary = replace(pilotid.SCENARIOS["single"], name="quick", duration=30.0)
    other = tmp_path / "other"
    other.mkdir()
    cells = {c.method: c for c in Study([ordinary], [Fake()], 1, SEED).run_in(other, 1).cells}
    assert [r.excess for r in cells["fake"].results] == [None]


def test_strata_and_parameters_stand_in_the_table(finished: Path) -> None:
    table = rows(finished, "population.csv")
    own = [r for r in table if r["method"] == "fake" and r["parameter"] == "all"]
    assert {r["stratum"] for r in own} >= {"all", "model", "element", "remnant", "level", "rate"}
    for stratum in {r["stratum"] for r in own}:
        parts = [r for r in own if r["stratum"] == stratum]
        assert sum(int(r["recordings"]) for r in parts) == COUNT, stratum
        assert sum(int(r["n"]) for r in parts) == int(own[0]["n"])
    (single,) = (r for r in own if r["value"] == "single")
    assert single["wrong_optima"] == single["recordings"]
    assert all(r["wrong_optima"] == "" for r in table if r["method"] == "mle-white")
    assert {r["loss"] != "" for r in own} == {True}
    whole = [r for r in table if (r["method"], r["stratum"]) == ("fake", "all")]
    assert [r["parameter"] for r in whole[1:]] == [
        "Kvis", "tlead", "tdvis", "Km", "tdm", "fnm", "dnm"
    ]  # fmt: skip


def test_the_summary_leaves_empty_what_needs_one_truth(finished: Path) -> None:
    for row in rows(finished, "summary.csv"):
        assert row["scenario"] == "quick"
        for column in ("truth", "bias", "bias_se", "bias_percent", "std", "rmse", "crlb"):
            assert row[column] == ""
        assert int(row["n"]) + int(row["failures"]) <= COUNT
        assert row["n"] == "0" or 0.0 <= float(row["coverage_95"]) <= 1.0


def test_a_fit_that_nobody_knows_the_pilot_of_is_a_row(tmp_path: Path) -> None:
    study = Study([QUICK], ["mle-white"], 2, SEED)
    with Store(tmp_path, create=True) as store:
        first, second = study.enter(store)
        store.add(Result(first, "died", "signal SIGKILL"))
        for _ in study.run(store, [second], 1):
            pass
        comparison = comparison_of(store)
        comparison.write_tables(tmp_path)
    (cell,) = comparison.populations
    assert (cell.overall.tried, cell.overall.failures) == (2, 1)
    assert next(iter(rows(tmp_path, "estimates.csv")))["outcome"] == "died"


def test_a_fit_whose_process_died_is_charged_by_its_own_pilot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def die(run: object, tasks: Iterable[Task], *_: object) -> Iterator[Result]:
        return (Result(task.unit, "died", "signal SIGKILL") for task in tasks)

    monkeypatch.setattr("pilotid.study.study.run_tasks", die)
    (cell,) = Study([QUICK], ["mle-white"], 2, SEED).run_in(tmp_path, 1).populations
    assert [r.draw for r in cell.results] == [scenario_of(QUICK, SEED, r)[1] for r in range(2)]
    assert cell.overall.loss.value > 0.0


def test_what_is_drawn_depends_on_seed_name_and_replication_alone() -> None:
    (first, draw), (again, _) = scenario_of(QUICK, 1, 3), scenario_of(replace(QUICK), 1, 3)
    assert draw is not None
    assert first == again
    others = [
        scenario_of(*key)[0]
        for key in ((QUICK, 2, 3), (QUICK, 1, 4), (replace(QUICK, name="q"), 1, 3))
    ]
    assert len({s.truth for s in (first, *others)}) == 4
    nominal = pilotid.SCENARIOS["nominal"]
    assert scenario_of(nominal, 1, 3) == (nominal, None)
    for scenario in (scenario_of(POPULATIONS["population-usual"], 1, r)[0] for r in range(12)):
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


def draw_of(model: str, **facts: float | str) -> Draw:
    return Draw(model, (), {"element": "K", "runs": 1, "dt": 0.02, "run_in": 0.0, **facts})


def test_strata_hold_every_recording_once() -> None:
    levels = np.linspace(0.05, 0.3, 9)
    draws = {
        r: draw_of("rate" if r % 3 else "multi", remnant_level=float(x),
                   duration=30.0 + 1e-15 * r, dt=0.02 if r < 4 else 0.005)
        for r, x in enumerate(levels)
    }  # fmt: skip
    strata = strata_of(draws)
    for name, stratum in strata.items():
        members = [r for own in stratum.values() for r in own]
        assert sorted(members) == list(range(9)), name
    assert strata["model"] == {"multi": frozenset({0, 3, 6}), "rate": frozenset({1, 2, 4, 5, 7, 8})}
    assert list(strata["rate"]) == ["50 Hz", "200 Hz"]
    assert strata["rate"]["50 Hz"] == frozenset(range(4))
    assert list(strata["length"]) == ["30 to 30 s"]
    assert [len(own) for own in strata["level"].values()] == [3, 3, 3]
    assert next(iter(strata["level"])) == "5 to 13 %"
    assert strata_of({})["level"] == {}
