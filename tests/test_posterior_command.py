"""`pilotid posterior`: tables, files, figures, and what follows from the draws."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import SINGLE_LOOP, Run, strict

from pilotid.checks.element_fit import ElementChoice
from pilotid.datasets import simulate
from pilotid.estimate.method import fit_all
from pilotid.methods.bayes import Bayes
from pilotid.model.catalogue import SINGLE
from pilotid.model.element import element_named
from pilotid.model.loops import margins
from pilotid.recording.files import save_recording
from pilotid.report.fit import quantities_of

RECORDING = simulate(SINGLE_LOOP, np.random.default_rng(31))


@pytest.mark.long
def test_the_command_writes_draws_summary_and_figures(run: Run, tmp_path: Path) -> None:
    file, out = tmp_path / "run.csv", tmp_path / "out"
    save_recording(RECORDING, file)
    printed = run("posterior", file, "--out", out, "--seed", 3)
    assert printed.status == 0, printed.err
    assert "bayes: converged" in printed.out
    assert "disturbance phase margin" in printed.out  # the element comes from the sidecar
    assert "loops with the controlled element 4/s^2 (the file says)" in printed.out
    assert " ensembles of " in printed.out
    draws = np.load(out / "draws.npy")
    assert draws.dtype.names == (*SINGLE.keys, "frequency", "damping", "log_density")
    with (out / "summary.csv").open(encoding="utf-8", newline="") as stream:
        rows = {row["quantity"]: row for row in csv.DictReader(stream)}
    assert float(rows["fnm"]["mean"]) == pytest.approx(draws["fnm"].mean())
    assert float(rows["fnm"]["std"]) == pytest.approx(draws["fnm"].std())
    assert all(float(rows[key]["effective_size"]) >= 2000.0 for key in SINGLE.keys)
    assert strict((out / "estimate.json").read_text())["outcome"] == "converged"
    text = (out / "corner.svg").read_text(encoding="utf-8")
    assert text.startswith("<svg")
    assert len(text) > 10_000
    assert (out / "corner.pdf").read_bytes().startswith(b"%PDF")
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("<svg ") == page.count("<figcaption>") == 5
    assert "the ensembles agree" in page
    assert ">disturbance phase margin<" in page
    assert not [path for path in out.iterdir() if path.name.endswith(".part")]


@pytest.mark.long
def test_each_of_several_files_has_its_folder(run: Run, tmp_path: Path) -> None:
    for name in ("a", "b"):
        save_recording(RECORDING, tmp_path / f"{name}.csv")
    files, out = (tmp_path / "a.csv", tmp_path / "b.csv"), tmp_path / "out"
    printed = run("posterior", *files, "--model", "single", "--runs", 1, "--out", out)
    assert printed.status == 0, printed.err
    assert sorted(path.parent.name for path in out.rglob("draws.npy")) == ["a", "b"]


def test_what_is_wrong_with_a_recording_is_told(run: Run, tmp_path: Path) -> None:
    still = tmp_path / "still.csv"
    save_recording(replace(RECORDING, e=np.zeros_like(RECORDING.e)), still)
    printed = run("posterior", still, "--out", tmp_path / "out")
    assert printed.status == 0
    assert "e does not move, so that the visual channel has no input" in printed.out
    assert "recording: e does not move: map it" in printed.out


def test_wrong_use_ends_with_a_sentence(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    save_recording(RECORDING, file)
    missing = run("posterior", "a.csv", "b.csv")
    unread = run("posterior", "--element", "four", file)
    assert missing.status == unread.status == 2
    assert (
        "a.csv: cannot be read (No such file or directory); check name, folder and rights; b"
        in missing.err
    )
    assert "the controlled element 'four' cannot be read: 'four'" in unread.err


def test_derived_quantities_are_those_of_the_parameters() -> None:
    element = element_named("4/s^2")
    fit = fit_all(RECORDING, SINGLE, {"bayes": Bayes()}, 1, element)
    (estimate,) = fit.estimates
    quantities = {s.key: s for s in quantities_of(fit)}
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
    assert abs(quantities["VAF"].value - estimate.vaf) < 2.0 * quantities["VAF"].std_error
    without = {s.key for s in quantities_of(replace(fit, loop_element=ElementChoice()))}
    assert "target crossover" not in without
