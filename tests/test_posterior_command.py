"""`pilotid posterior`: tables, files, figures, and what follows from the draws."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import SINGLE_LOOP, Run, strict

from pilotid.datasets import simulate
from pilotid.estimate.quantities import sampled
from pilotid.likelihood.estimates import simulated_vaf
from pilotid.likelihood.remnant_models import Autoregressive, LowPass
from pilotid.methods.bayes import Bayes, Inference
from pilotid.model.catalogue import SINGLE
from pilotid.model.element import double_integrator
from pilotid.model.loops import margins
from pilotid.posterior.likelihood import Marginal
from pilotid.posterior.predictive import derived, predictive_band, vafs
from pilotid.recording.files import save_recording

RECORDING = simulate(SINGLE_LOOP, np.random.default_rng(31))


@pytest.fixture(scope="module")
def inference() -> Inference:
    return Bayes().infer(RECORDING, SINGLE, np.random.default_rng(1))


@pytest.mark.long
def test_the_command_writes_draws_summary_and_figures(run: Run, tmp_path: Path) -> None:
    file, out = tmp_path / "run.csv", tmp_path / "out"
    save_recording(RECORDING, file)
    printed = run("posterior", file, "--out", out, "--seed", 3)
    assert printed.status == 0, printed.err
    assert "bayes: converged" in printed.out
    assert "disturbance phase margin" in printed.out  # the element comes from the sidecar
    assert "loops with the controlled element 4/s^2, named by the recording" in printed.out
    assert " ensembles of " in printed.out
    draws = np.load(out / "draws.npy")
    assert draws.dtype.names == (*SINGLE.keys, "frequency", "damping", "log_density")
    with (out / "summary.csv").open(encoding="utf-8", newline="") as stream:
        rows = {row["quantity"]: row for row in csv.DictReader(stream)}
    assert float(rows["fnm"]["mean"]) == pytest.approx(draws["fnm"].mean())
    assert float(rows["fnm"]["std"]) == pytest.approx(draws["fnm"].std())
    assert all(float(rows[key]["effective_size"]) >= 2000.0 for key in SINGLE.keys)
    assert strict((out / "estimate.json").read_text())["outcome"] == "converged"
    for name in ("corner", "predictive"):
        text = (out / f"{name}.svg").read_text(encoding="utf-8")
        assert text.startswith("<svg")
        assert len(text) > 10_000
        assert (out / f"{name}.pdf").read_bytes().startswith(b"%PDF")
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("<svg ") == page.count("<figcaption>") == 6
    assert "the ensembles agree" in page
    assert "posterior predictive band." in page
    assert ">disturbance phase margin<" in page
    assert not [path for path in out.iterdir() if path.name.endswith(".part")]


def test_what_is_wrong_with_a_recording_is_told(run: Run, tmp_path: Path) -> None:
    still = tmp_path / "still.csv"
    save_recording(replace(RECORDING, e=np.zeros_like(RECORDING.e)), still)
    printed = run("posterior", still, "--out", tmp_path / "out")
    assert printed.status == 0
    assert "e does not move, so that the visual channel has no input" in printed.out
    assert "recording: e does not move: map it" in printed.out


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["a.csv", "b.csv"], "a.csv: there is no such file; check the name and the folder; b.csv"),
        (
            ["a.csv", "--element", "four"],
            "the controlled element 'four' cannot be read: 'four'",
        ),
    ],
)
def test_wrong_use_ends_with_a_sentence(run: Run, arguments: list[str], sentence: str) -> None:
    answer = run("posterior", *arguments)
    assert answer.status == 2
    assert sentence in answer.err


def test_derived_quantities_are_those_of_the_parameters(inference: Inference) -> None:
    draws = inference.estimate.draws
    assert draws is not None
    some = draws.thinned(3)[:, :5]
    expected = [simulated_vaf(RECORDING, SINGLE, own) for own in some]
    np.testing.assert_allclose(vafs(RECORDING, SINGLE, some), expected, rtol=1e-9)
    element = double_integrator(4.0)
    quantities = {s.key: s for s in derived(draws, SINGLE, RECORDING, element)}
    target, disturbance = margins(SINGLE, SINGLE_LOOP.values, element)
    for key, truth in (
        ("Kvis*tlead", SINGLE_LOOP.truth[0] * SINGLE_LOOP.truth[1]),
        ("target crossover", target.crossover),
        ("target phase margin", target.phase_margin),
        ("disturbance crossover", disturbance.crossover),
        ("disturbance phase margin", disturbance.phase_margin),
    ):
        spread = quantities[key]
        assert abs(spread.value - truth) < 3.5 * spread.std_error, key
        assert spread.lower < spread.value < spread.upper
    assert "target crossover" not in {s.key for s in derived(draws, SINGLE, RECORDING, None)}


def test_a_quantity_of_equal_draws_has_no_spread() -> None:
    spread = sampled("x", "", np.full(10, 2.0))
    assert spread.value == pytest.approx(2.0)
    assert spread.std_error < 1e-9


@pytest.mark.parametrize("noise", [LowPass(2), Autoregressive(4)], ids=lambda n: n.name)
def test_the_predictive_band_holds_what_it_says(noise: LowPass | Autoregressive) -> None:
    two = simulate(replace(SINGLE_LOOP, runs=2), np.random.default_rng(32))
    found = Bayes(noise=noise).infer(two, SINGLE, np.random.default_rng(2))
    assert isinstance(found.likelihood, Marginal)
    draws = found.estimate.draws
    assert draws is not None
    band = predictive_band(draws, found.likelihood, np.random.default_rng(3))
    assert band.control.shape[0] == 2
    assert band.time.size == band.control.shape[1]
    # Correlated samples: the remnant's 160 s are some hundred independent ones.
    assert band.inside == pytest.approx(0.95, abs=0.04)
    widths = np.diff(band.model, axis=0).mean(), np.diff(band.with_remnant, axis=0).mean()
    assert widths[0] < 0.5 * widths[1]
