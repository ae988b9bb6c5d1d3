"""What an analysis computes of recordings: variances and their parts, and runs left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import NOMINAL, SINGLE_LOOP, recording_of

from pilotid.datasets import simulate
from pilotid.estimate.estimate import Outcome, failed
from pilotid.experiment.fits import lines_shared, performance, predict_left_out
from pilotid.methods.mle_white import MLEWhite
from pilotid.support.numbers import recording_rng

pytestmark = pytest.mark.numerical


def test_the_parts_are_those_of_loops_that_one_source_drives_alone() -> None:
    """The loop is linear: target, disturbance and remnant add up to what each would do alone."""
    runs = 60
    quiet = replace(NOMINAL, remnant=replace(NOMINAL.remnant, level=0.0))
    recording = simulate(replace(NOMINAL, runs=runs), recording_rng(3, "split"))
    alone = {
        "target": simulate(replace(quiet, disturbance=None), recording_rng(3, "target")),
        "disturbance": simulate(replace(quiet, target=None), recording_rng(3, "disturbance")),
        "remnant": simulate(
            replace(NOMINAL, target=None, disturbance=None, runs=runs), recording_rng(4, "remnant")
        ),
    }
    found = performance(recording)
    for name in ("e", "u", "x"):
        total = found[f"var_{name}"][1]
        parts = {source: found[f"var_{name}_{source}"][1] for source in alone}
        assert total == pytest.approx(sum(parts.values()))
        for source, own in parts.items():
            signal = alone[source].window(getattr(alone[source], name))
            expected = signal.var(axis=1)
            error = np.hypot(own.std() / np.sqrt(runs), expected.std() / np.sqrt(len(expected)))
            assert abs(own.mean() - expected.mean()) < 4.0 * error, (name, source)
    unit, share = found["remnant_share_u"]
    assert unit == ""
    assert share == pytest.approx(found["var_u_remnant"][1] / found["var_u"][1])
    assert found["var_e"][0] == "deg^2"


def test_lines_in_common_are_not_split_and_a_sentence_says_so() -> None:
    shared = replace(NOMINAL, disturbance=replace(NOMINAL.disturbance, lines=NOMINAL.target.lines))
    recording = simulate(shared, recording_rng(1, "shared"))
    assert lines_shared(simulate(NOMINAL, recording_rng(1, "apart"))) is None
    assert "not split" in str(lines_shared(recording))
    assert not [key for key in performance(recording) if "remnant" in key]


def test_forcing_without_lines_has_totals_alone() -> None:
    recording = simulate(NOMINAL, recording_rng(1, "aperiodic"))
    ft = np.cumsum(np.random.default_rng(0).normal(size=recording.u.shape), axis=1)
    found = performance(replace(recording, ft=ft, lines={}))
    assert set(found) == {f"{what}_{name}" for what in ("var", "rms") for name in ("e", "u", "x")}
    assert found["rms_e"][1] ** 2 == pytest.approx(np.mean(recording.window(recording.e) ** 2))


@pytest.mark.parametrize(("absent", "left"), [("disturbance", "target"), ("target", "disturbance")])
def test_a_loop_that_nothing_excites_has_no_margins(absent: str, left: str) -> None:
    scenario = replace(NOMINAL, disturbance=None) if absent == "disturbance" else NOMINAL
    recording = simulate(scenario, recording_rng(1, "one loop"))
    if absent == "target":
        recording = replace(recording, e=-recording.x, ft=None)
    size = len(NOMINAL.values)
    fit = replace(
        failed("a", NOMINAL.model, Outcome.CONVERGED),
        values=NOMINAL.values,
        covariance=1e-6 * np.eye(size),
    )
    loops = fit.loops(NOMINAL.element).excited_by(recording)
    assert [q.key for q in loops.quantities] == [f"{left}_crossover", f"{left}_phase_margin"]
    assert all(np.isfinite(q.value) for q in loops.quantities)
    assert np.isnan(getattr(loops, absent).crossover.value)


# ------------------------------------------------------------------ runs left out


def test_every_run_is_predicted_by_the_others() -> None:
    recording = recording_of(replace(SINGLE_LOOP, runs=4))
    every = [*predict_left_out(recording, SINGLE_LOOP.model, {"mine": MLEWhite()}, 1)]
    assert [row["run"] for row in every] == [1, 2, 3, 4]
    found = every[2]
    assert found["method"] == "mine"
    assert found["outcome"] == "converged"
    assert 40.0 < found["vaf"] < 100.0
