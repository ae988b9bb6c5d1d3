"""Designs: errors against bounds, the optimum against another search, limits, crests, files."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import NOMINAL, SINGLE_LOOP, Run
from scipy.optimize import LinearConstraint, minimize

import pilotid
from pilotid.datasets import scenario_named
from pilotid.datasets.bounds import bounds
from pilotid.datasets.design import (
    LARGEST_SHARE,
    LEAST_SHARE,
    Design,
    crest_of,
    design,
    least,
    low_crest,
    scenario_of_fit,
    sines_of,
)
from pilotid.datasets.experiments import experiment_of
from pilotid.datasets.signals import Multisine, paper_target
from pilotid.estimate.method import fit_all
from pilotid.likelihood.optimum import BARTLETT_SECONDS
from pilotid.methods import method_named
from pilotid.model.catalogue import MULTI
from pilotid.study.trust import fitted_scenario
from pilotid.support.types import FloatArray, InputError

pytestmark = pytest.mark.numerical


@cache
def made(minimise: str = "A", limit: float = 2.0) -> Design:
    return pilotid.design("nominal", minimise, limits={"e": limit, "u": limit})


def test_errors_are_the_bounds_of_the_designs_scenario() -> None:
    found = made()
    scenario = found.scenario
    short = 1.0 + BARTLETT_SECONDS / scenario.duration
    for own, name in ((scenario, "errors"), (found.reference, "reference_errors")):
        errors = found.errors[name]
        bound = np.sqrt(short * np.diag(bounds(experiment_of(own)).low_pass)) / own.values
        np.testing.assert_allclose(list(errors.values()), bound, rtol=1e-5)
    short = 1.0 + BARTLETT_SECONDS / (5 * scenario.duration)
    five = bounds(experiment_of(replace(scenario, runs=5))).low_pass
    expected = np.sqrt(short * np.diag(five)) / scenario.values
    np.testing.assert_allclose(list(found.errors["five_runs"].values()), expected, rtol=1e-5)
    ratios = [found.errors["twice"][key] / e for key, e in found.errors["errors"].items()]
    assert all(0.68 < ratio < 2.0**-0.5 for ratio in ratios)


def test_costs_are_those_of_simulations() -> None:
    found = made()
    seen = [
        [np.mean(own.window(own.e) ** 2), np.mean(own.window(own.u) ** 2)]
        for scenario in (found.scenario, found.reference)
        for own in [pilotid.simulate(replace(scenario, runs=200), 3)]
    ]
    np.testing.assert_allclose(np.array(seen[0]) / seen[1], list(found.costs.values()), rtol=0.05)


@pytest.mark.parametrize("kind", ["A", "D"])
def test_the_optimum_is_that_of_another_search(kind: str) -> None:
    rng = np.random.default_rng(2)
    factors, base = rng.normal(size=(6, 3, 2)), 0.1 * np.eye(3)
    by_line = factors @ factors.transpose(0, 2, 1)
    rows, room = rng.uniform(0.5, 1.5, (2, 6)), np.ones(2)
    weights = np.array([1.0, 2.0, 0.0])

    def value(powers: FloatArray) -> float:
        information = base + np.tensordot(powers, by_line, 1)
        if kind == "D":
            return float(-np.linalg.slogdet(information)[1])
        return float(weights @ np.diag(np.linalg.inv(information)))

    limits = [LinearConstraint(rows, -np.inf, room)]
    found = least(base, by_line, None if kind == "D" else weights, limits)
    assert (found >= 0.0).all()
    assert (rows @ found <= room + 1e-8).all()
    inside = {"type": "ineq", "fun": lambda powers: room - rows @ powers}
    other = minimize(value, np.full(6, 0.1), bounds=[(0.0, None)] * 6, constraints=[inside])
    assert value(found) == pytest.approx(other.fun, rel=1e-5)


@pytest.mark.parametrize("minimise", ["A", "D", "Kvis,tlead"])
def test_designs_keep_their_limits_and_are_no_worse(minimise: str) -> None:
    found = made(minimise, 1.5)
    assert max(found.costs.values()) <= 1.5 + 1e-6
    before, after = (
        np.array(list(found.errors[n].values())) for n in ("reference_errors", "errors")
    )
    if minimise == "D":
        assert np.log(after).mean() < np.log(before).mean()
    else:
        used = slice(None) if minimise == "A" else slice(0, 2)
        assert (after[used] ** 2).mean() < 0.8 * (before[used] ** 2).mean()
    for name, sines in sines_of(found.scenario).items():
        powers = np.array(sines.amplitudes) ** 2
        usual = np.array(sines_of(NOMINAL)[name].amplitudes) ** 2
        share, known = powers / powers.sum(), usual / usual.sum()
        assert powers.sum() <= usual.sum() * (1.0 + 1e-6)
        assert (share >= LEAST_SHARE * known * (1.0 - 1e-4)).all()
        assert (share <= np.maximum(LARGEST_SHARE, known) * (1.0 + 1e-4)).all()


def test_crest_factors_are_low() -> None:
    found = made()
    assert max(crest for crest, _ in found.crest.values()) <= 2.65
    assert all(crest < reference for crest, reference in found.crest.values())
    lines = (3, 5, 7, 11, 17, 23, 31, 43, 61, 89)
    even = Multisine(lines, (1.0,) * 10, (0.0,) * 10, 50.0)
    assert crest_of(low_crest(even, np.random.default_rng(1))) < 2.1
    one = Multisine((1,), (1.0,), (0.0,), 50.0)
    assert crest_of(one) == pytest.approx(np.sqrt(2.0), rel=1e-3)


@pytest.mark.parametrize(
    "words",
    [
        ("nominal", "--limit", "e=-1"),
        ("nominal", "--limit", "e=nan"),
        ("nominal", "--limit", "e=0.5,u=0.5"),
        ("nominal", "--limit", "x=1"),
        ("nominal", "--minimise", "E"),
        ("nominal", "--minimise", "Kvis,nothing"),
        ("population-usual",),
        ("nominal(duration=100)",),
        ("nominal", "--from", "nowhere.json"),
    ],
)
def test_what_cannot_be_is_one_sentence(words: tuple[str, ...], tmp_path: Path, run: Run) -> None:
    answer = run("design", *words, "--out", tmp_path / "out")
    assert answer.status == 2
    assert len(answer.err.splitlines()) == 1


@pytest.mark.parametrize(("start", "error"), [(1.0, 1e-6), (0.0, 2e-4)])  # faded in, or not
def test_the_reference_is_the_users_own_experiment(
    start: float, error: float, tmp_path: Path
) -> None:
    target = paper_target().scaled(2.0).with_random_phases(np.random.default_rng(1))
    own = replace(NOMINAL, target=target, runs=2, dt=0.04, units=(("x", "m"),))
    recording = pilotid.simulate(own, 3)
    fade = np.interp(recording.time, [recording.time[0], -1.0], [start, 1.0])
    recording = replace(recording, **{n: fade * s for n, s in recording.arrays.items()})
    fitted = fit_all(recording, MULTI, {"mle": method_named("mle")}, 1, "4/s^2")
    entry: Any = {**fitted.to_dict(), "scenario": fitted_scenario(fitted)}
    file = tmp_path / "estimates.json"

    def read(entry: object, scenario: pilotid.Scenario | None = None) -> pilotid.Scenario:
        file.write_text(json.dumps(entry))
        return scenario_of_fit(file, scenario)

    found, estimate = read(entry), entry["estimates"][0]
    assert sines_of(found).keys() == sines_of(own).keys()
    for name, sines in sines_of(found).items():
        time = np.arange(0.0, 10.0)
        np.testing.assert_allclose(sines.at(time), sines_of(own)[name].at(time), atol=error)
    assert (found.runs, found.dt, found.run_in) == (2, 0.04, 8.0)
    assert found.element.name == "4/s^2"
    assert dict(found.units)["x"] == "m"
    assert found.truth[2] == estimate["parameters"]["tdvis"]["value"]
    named = read(entry, NOMINAL)
    assert (named.target, named.runs, named.truth) == (NOMINAL.target, 1, found.truth)
    for broken in ([entry, entry], {**entry, "scenario": None}):
        with pytest.raises(InputError):
            read(broken)
    white = fit_all(recording, MULTI, {"mle-white": method_named("mle-white")}, 1)
    assert fitted_scenario(white) is None


def test_the_command_writes_what_others_read(tmp_path: Path, run: Run) -> None:
    out = tmp_path / "design"
    limits = {"e": 1.5, "u": 1.5}
    assert run("design", "single", "--limit", "e=1.5,u=1.5", "--out", out).status == 0
    held = json.loads((out / "design.json").read_text())
    scenario = scenario_named(str(out / "design.json"))
    again = design(SINGLE_LOOP, limits=limits)
    assert scenario == again.scenario
    assert held["errors"] == again.errors["errors"]
    assert held["objective"] == {"minimise": "A", "limits": limits}
    assert held["scenario"]["name"] == scenario.name
    page = (out / "report.html").read_text()
    assert "frequency [rad/s]" in page
    assert "target ft [deg]" in page
    with (out / "forcing.csv").open(newline="") as stream:
        head, *rows = csv.reader(stream)
    assert head == ["t", "ft", "fd"]
    time, ft, fd = np.array(rows, dtype=float).T
    assert time[0] == pytest.approx(-8.0)
    assert time[-1] == pytest.approx(scenario.duration + 2.0, abs=0.01)
    assert max(abs(ft[0]), abs(ft[-1]), abs(fd[0]), abs(fd[-1])) < 1e-9
    inside = (time >= 0.0) & (time < scenario.duration)
    sines = sines_of(again.scenario)["ft"]
    np.testing.assert_allclose(ft[inside], sines.at(time[inside]), atol=1e-7)
    (out / "design.json").write_text("[]")
    with pytest.raises(InputError):
        scenario_named(str(out / "design.json"))
