"""Parameters that are held: by any method, at their value, without an interval."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers import Run

from pilotid.datasets import SCENARIOS, simulate
from pilotid.estimate.estimate import Outcome
from pilotid.estimate.method import identify
from pilotid.methods import METHODS, method_named
from pilotid.model.catalogue import MODELS, with_held
from pilotid.support.types import InputError

OMEGA = np.array([0.5, 2.0, 7.0, 15.0])
HELD = {"fnm": 12.0, "tdvis": 0.3}


@pytest.mark.numerical
def test_response_and_jacobian_are_those_of_the_whole_model() -> None:
    whole, model = MODELS["multi"], MODELS["multi"].with_fixed(**HELD)
    assert model.held == HELD
    assert set(model.keys) == set(whole.keys) - set(HELD)
    free = dict(zip(model.keys, 1.1 * model.start, strict=True))
    response, jacobian = model.response_and_jacobian(OMEGA, model.vector(free))
    expected, slopes = whole.response_and_jacobian(OMEGA, whole.vector(free | HELD))
    np.testing.assert_allclose(response, expected, rtol=1e-12)
    kept = [whole.keys.index(key) for key in model.keys]
    np.testing.assert_allclose(jacobian, slopes[:, kept], rtol=1e-8, atol=1e-12)
    for own, other in zip(
        model.polynomials(model.vector(free)),
        whole.polynomials(whole.vector(free | HELD)),
        strict=True,
    ):
        for one, another in zip(own, other, strict=True):
            np.testing.assert_allclose(one, another)
    assert model.with_fixed(dnm=0.3).held == HELD | {"dnm": 0.3}


@pytest.mark.numerical
@pytest.mark.parametrize("name", [m for m in METHODS if m != "mle-genetic"])
def test_every_method_holds_them_or_says_why_not(name: str) -> None:
    scenario = SCENARIOS["nominal"]
    truth = dict(zip(scenario.model.keys, scenario.values.tolist(), strict=True))
    held = {key: truth[key] for key in ("fnm", "tdvis")}
    model = scenario.model.with_fixed(**held)
    recording = simulate(scenario, np.random.default_rng(3))
    estimate = identify(method_named(name), recording, model, np.random.default_rng(0))
    assert estimate.model.keys == model.keys
    assert estimate.to_dict()["held"] == held
    if estimate.outcome is Outcome.NOT_APPLICABLE:
        assert estimate.message
    else:
        assert np.isfinite(estimate.values).all()


def test_bounds_are_those_that_are_given() -> None:
    (model,) = with_held([MODELS["single"]], "fnm=10..14,dnm=0.1..0.5")
    assert (model.lower[model.index["fnm"]], model.upper[model.index["fnm"]]) == (10.0, 14.0)
    assert 10.0 < model.start[model.index["fnm"]] < 14.0
    assert model.held == {}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fnx=3", "no model here has a parameter fnx"),
        ("fnm=9,fnm=12", "no model here has a parameter fnm that is not held"),
        ("fnm", "is not PARAMETER=NUMBER"),
        ("fnm=-1", "cannot be held at -1"),
        ("fnm=100", "fnm cannot be held at 100; give a number from 2 to 40 rad/s"),
        ("tdvis=250", "tdvis cannot be held at 250; give a number from 0 to 1 s"),
        ("fnm=nan", "cannot be held at nan"),
        ("fnm=14..10", "are no bounds"),
    ],
)
def test_what_makes_no_sense_is_refused(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        with_held([MODELS["single"]], text)
    with pytest.raises(InputError, match="varies in time"):
        MODELS["adapting"].with_fixed(tlead1=1.0)


@pytest.mark.long
def test_analyse_holds_parameters(run: Run, tmp_path: Path) -> None:
    file, out = tmp_path / "s1_A.csv", tmp_path / "out"
    assert run("simulate", "single", "--seed", "1", "--out", str(file)).status == 0
    options = ("--pattern", "s{subject}_{condition}", "--out", str(out), "--workers", "1")
    assert run("analyse", str(file), *options, "--fix", "fnm=12,dnm=.3").status == 0
    rows = (out / "estimates.csv").read_text("utf-8")
    assert ",Kvis," in rows
    assert ",fnm," not in rows


def test_fit_holds_parameters_and_analyse_names_unknown_ones(run: Run, tmp_path: Path) -> None:
    file, out = tmp_path / "s1_A.csv", tmp_path / "out"
    assert run("simulate", "single", "--seed", "1", "--out", str(file)).status == 0
    answer = run("fit", str(file), "--model", "single", "--fix", "fnm=12,dnm=.3", "--json", "-")
    (entry,) = json.loads(answer.out)["estimates"]
    assert entry["held"] == {"fnm": 12.0, "dnm": 0.3}
    assert "fnm" not in entry["parameters"]
    words = run("fit", str(file), "--model", "single", "--fix", "fnm=12").out
    assert "held, not estimated: fnm = 12 rad/s" in words
    options = ("--pattern", "s{subject}_{condition}", "--out", str(out), "--workers", "1")
    assert run("analyse", str(file), *options, "--fix", "fnx=12").status == 2
