"""Scenarios made of recordings, and what simulations of them say of a fit."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import NOMINAL, Run, recording_of, strict

import pilotid
from pilotid.datasets import Scenario, simulate
from pilotid.datasets.named import designed_scenario, scenario_json
from pilotid.datasets.recorder import Recorder
from pilotid.datasets.signals import Remnant, TabulatedRemnant, half_and_half_step
from pilotid.estimate.estimate import Estimate, Outcome
from pilotid.estimate.quantities import Specification
from pilotid.likelihood.remnant_models import Autoregressive, LowPass, NoiseModel
from pilotid.methods.mle import MLE
from pilotid.model.catalogue import ADAPTING
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import floors_of
from pilotid.study.trust import length_factor, scenario_of_estimate, try_fit
from pilotid.support.types import FloatArray, InputError

pytestmark = pytest.mark.numerical

RECORDED = replace(NOMINAL, name="recorded", runs=2)


def fitted(scenario: Scenario, noise: NoiseModel | None = None) -> tuple[Recording, Estimate]:
    recording = recording_of(scenario)
    return recording, pilotid.identify(MLE(noise=noise), recording, scenario.model)


def power(recording: Recording, signal: FloatArray) -> float:
    return float(np.mean(np.var(recording.window(signal), axis=1)))


@pytest.mark.parametrize("noise", [LowPass(2), Autoregressive(16)])
def test_simulations_have_the_recorded_variance_and_spectrum_of_the_control(
    noise: NoiseModel,
) -> None:
    recording, estimate = fitted(RECORDED, noise)
    made = scenario_of_estimate(estimate, recording)
    simulated = [simulate(made, np.random.default_rng(i)) for i in range(30)]
    for name in ("u", "e"):
        every = np.array([power(s, getattr(s, name)) for s in simulated])
        wanted = power(recording, getattr(recording, name))
        assert abs(every.mean() - wanted) < 3.0 * every.std(ddof=1)
    # The spectrum, in eight bands from 0.5 rad/s to half the sampling rate.
    edges = np.geomspace(0.5, math.pi / recording.dt, 9)

    def levels(own: Recording) -> FloatArray:
        floors = floors_of(own)
        place = np.digitize(floors.omega, edges)
        return np.array([np.log(floors.power["u"][place == i]).mean() for i in range(1, 9)
                         if np.any(place == i)])  # fmt: skip

    every = np.array([levels(s) for s in simulated])
    assert np.all(np.abs(every.mean(axis=0) - levels(recording)) < 4.0 * every.std(axis=0, ddof=1))


def test_forcing_functions_are_as_recorded() -> None:
    recording, estimate = fitted(RECORDED)
    made = scenario_of_estimate(estimate, recording)
    assert made.target.lines == NOMINAL.target.lines  # type: ignore[union-attr]
    np.testing.assert_allclose(made.disturbance.at(recording.time), recording.fd[0], atol=1e-9)
    assert (made.dt, made.duration, made.run_in, made.runs) == (0.02, 81.92, 8.0, 2)
    assert made.truth == tuple(estimate.values.tolist())
    assert isinstance(made.remnant, TabulatedRemnant)


def test_a_target_without_periods_is_recorded_too() -> None:
    step = half_and_half_step(NOMINAL.duration, 2.0)
    recording, estimate = fitted(replace(RECORDED, target=step), LowPass(2))
    made = scenario_of_estimate(estimate, recording)
    rest = made.target.at(recording.time) - recording.ft[0]
    assert np.std(rest) < 0.03 * np.std(recording.ft)
    again = simulate(replace(made, runs=1), np.random.default_rng(1))
    assert abs(np.log(power(again, again.u) / power(recording, recording.u))) < 0.4


def test_the_recorder_adds_what_was_found_on_the_output() -> None:
    noisy = replace(RECORDED, recorder=Recorder(noise=(0.0, 0.0, 0.01), makes_error=True))
    recording, estimate = fitted(noisy)
    recorder = scenario_of_estimate(estimate, recording).recorder
    assert recorder.makes_error
    assert recorder.noise[:2] == (0.0, 0.0)
    assert recorder.noise[2] == pytest.approx(0.01, rel=0.1)


def test_a_scenario_of_a_recording_is_read_again_from_json(tmp_path: Path) -> None:
    recording, estimate = fitted(RECORDED)
    made = scenario_of_estimate(estimate, replace(recording, units={"u": "V"}))
    for own in (made, replace(made, recorder=Recorder(noise=(0.0, 0.0, 0.01)))):
        path = tmp_path / "trust.json"
        path.write_text(json.dumps({"scenario": scenario_json(own)}), encoding="utf-8")
        assert designed_scenario(path) == own
    assert dict(simulate(made, np.random.default_rng(1)).units) == {"u": "V"}


def test_what_cannot_be_simulated_is_refused() -> None:
    recording, estimate = fitted(RECORDED)
    bare = replace(recording, controlled_element="", fd=None, x=np.roll(recording.x, 999, axis=1))
    unstable = replace(estimate, values=estimate.values * np.array([9.0, 1, 1, 1, 1, 1, 1]))
    other = np.array([recording.fd[0], np.roll(recording.fd[0], 500)])
    for own, of, words in (
        (replace(estimate, outcome=Outcome.SINGULAR), recording, "cannot be simulated"),
        (replace(estimate, remnant=None), recording, "has no remnant"),
        (replace(estimate, model=ADAPTING), recording, "varies in time"),
        (unstable, recording, "is unstable"),
        (estimate, replace(recording, fd=other), "fd differs from run to run"),
        (estimate, bare, "the controlled element is not known"),
    ):
        with pytest.raises(InputError, match=words):
            scenario_of_estimate(own, of)


def test_length_factor_on_numbers_by_hand() -> None:
    # 19 intervals of half-length 2 whose values miss the truth, 10, by .1, .2, ..., 1.9: of 19 the
    # ceil(.95 * 20) = 19th smallest factor is 1.9 / 2.
    misses = 0.1 * np.arange(1, 20)
    value = 10.0 + misses * (-1.0) ** np.arange(19)
    assert length_factor(value, value - 2.0, value + 2.0, 10.0) == pytest.approx(0.95)
    # The side towards the truth counts: below it the upper side, here half as long.
    assert length_factor(value, value - 2.0, value + 1.0, 10.0) == pytest.approx(1.8)
    # Of 39 it is the 38th; intervals without an end hold everything.
    both = np.concatenate([value, value, [20.0]])
    assert length_factor(both, both - 2.0, both + 2.0, 10.0) == pytest.approx(0.95)
    assert length_factor(both, both - np.inf, both + np.inf, 10.0) == 0.0
    assert length_factor(value, value, value, 10.0) == math.inf
    assert math.isnan(length_factor(value[1:], value[1:] - 2.0, value[1:] + 2.0, 10.0))


@pytest.mark.long
def test_the_command_and_python_write_and_say_the_same(run: Run, tmp_path: Path) -> None:
    file, out = tmp_path / "run.csv", tmp_path / "trust"
    assert run("simulate", "nominal", "--seed", 3, "--out", file).status == 0
    options = ("--model", "multi", "--method", "mle-white,mle", "--replications", 20)
    answer = run("trust", file, *options, "--out", out)
    assert answer.status == 0
    assert "mle-white's interval of" in answer.out
    names = {path.name for path in out.iterdir()}
    assert names >= {"trust.json", "report.html", "report.md", "study.sqlite", "estimates.csv",
                     "summary.csv", "figures"}  # fmt: skip
    held = strict((out / "trust.json").read_text(encoding="utf-8"))
    assert (held["method"], held["replications"]) == ("mle-white", 20)
    assert held["methods"]["mle"]["loss"] < held["methods"]["mle-white"]["loss"]
    recording = pilotid.load_recording(file)
    trust = pilotid.trust(recording, "multi", ["mle-white", "mle"], 20, out=tmp_path / "python")
    # What does not depend on the path of the recording.
    assert list(trust.parameters) == list(held["parameters"])
    worst = min(trust.parameters.values(), key=lambda p: p["coverage"])
    assert worst["coverage_95"][1] < 0.95
    assert worst["factor"] > 2.0
    corrected = held["parameters"][worst["parameter"]]["corrected_95"]
    claimed = held["parameters"][worst["parameter"]]["interval_95"]
    assert corrected[0] <= claimed[0] < claimed[1] < corrected[1]
    assert run("report", out).status == 0
    assert 'id="trust"' in (out / "report.html").read_text(encoding="utf-8")

    # The scenario of it, from the file.
    again = tmp_path / "again.csv"
    assert run("simulate", out / "trust.json", "--out", again).status == 0
    assert pilotid.load_recording(again).duration == recording.duration
    told = run("compare", "--like", out / "trust.json", "--method", "mle-white", "--replications",
               2, "--out", tmp_path / "like")  # fmt: skip
    assert told.status == 0
    assert "like-run" in told.out
    other = run("trust", file, "--model", "single", *options[2:], "--out", out)
    assert other.status == 2
    assert "another recording, model or method" in other.err


def test_commands_refuse_what_has_no_scenario(run: Run, tmp_path: Path) -> None:
    assert run("simulate", "--out", tmp_path / "x.csv").status == 2
    for settings in ("runs=-1", "dt=0", "duration=-5", "run_in=-3", "start_spread=-1"):
        told = run("simulate", f"nominal({settings})", "--out", tmp_path / "x.csv")
        assert told.status == 2
        assert settings.partition("=")[0] in told.err
    none = run("trust", tmp_path / "none.csv", "--out", tmp_path / "out")
    assert (none.status, len(none.err.splitlines())) == (2, 1)


def test_the_remnant_of_a_table_has_its_density() -> None:
    table = TabulatedRemnant(omega=(1.0, 10.0), density=(4.0, 1.0))
    found = np.abs(table.filter(np.array([0.5, 1.0, 5.5, 10.0, 11.0]))) ** 2
    np.testing.assert_allclose(found, [4.0, 4.0, 2.0, 1.0, 0.0])
    assert table.log_slopes(np.ones(3)).shape == (0, 3)
    assert isinstance(table, Remnant)


def test_simulations_of_a_fit_that_the_lines_contradict_cannot_be_believed(tmp_path: Path) -> None:
    found = try_fit(recording_of(NOMINAL, 1), NOMINAL.model, ["fourier"], tmp_path, 2, workers=1)
    assert found.specification.agrees
    doubtful = replace(found, specification=Specification(60.0, 1e-9, "fourier"))
    assert len(doubtful.sentences) == len(found.sentences) + 1
    assert "p = 1e-09" in doubtful.to_dict()["sentences"][0]
    for p, count in ((0.02, 0), (0.001, 1)):  # of seven parameters
        found.parameters["Kvis"]["coverage_p"] = p
        assert sum("interval of Kvis covers" in sentence for sentence in found.sentences) == count
