"""The pilot that the forcing functions' lines show, and what does not follow the control."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import NOMINAL, fit_of, minima_at, without_remnant

from pilotid.datasets import simulate
from pilotid.estimate.estimate import Outcome
from pilotid.likelihood.optimum import MIN_VAF_RATIO, PilotCheck
from pilotid.likelihood.prediction import predict
from pilotid.likelihood.prepare import analysis_band
from pilotid.likelihood.search import maximise_likelihood
from pilotid.methods.mle import MLE
from pilotid.spectral.equations import fit_lines

pytestmark = pytest.mark.numerical

TRUTH = NOMINAL.values
#: A pilot who does next to nothing.
IDLE = np.concatenate([[1e-3 * TRUTH[0]], TRUTH[1:3], [1e-3 * TRUTH[3]], TRUTH[4:]])


def following(known: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> PilotCheck:
    recording = simulate(NOMINAL, np.random.default_rng(1))
    return PilotCheck(predict(recording, NOMINAL.model, 50.0).binned, known)


def test_the_lines_alone_tell_the_pilot_where_there_is_no_remnant() -> None:
    recording = simulate(without_remnant(NOMINAL), np.random.default_rng(1))
    found = fit_lines(recording, NOMINAL.model, np.random.default_rng(2))
    np.testing.assert_allclose(found.values, TRUTH, rtol=0.02)
    # Best of all at the lines, but for what each of the two ways of fitting leaves.
    others = np.array([found.values, 1.2 * TRUTH, IDLE])
    misfits = [replace(found, values=values).misfit for values in others]
    assert np.argmin(misfits) == 0


def test_the_lines_optimum_does_not_depend_on_the_starts() -> None:
    recording = simulate(NOMINAL, np.random.default_rng(3))
    ends = [
        fit_lines(recording, NOMINAL.model, np.random.default_rng(seed)).minimised().values
        for seed in range(3)
    ]
    np.testing.assert_allclose(ends[1:], [ends[0], ends[0]], rtol=0.02)


def test_who_explains_far_less_than_the_lines_pilot_does_not_follow() -> None:
    judged = following(TRUTH[None])
    own, idle = judged.explained(np.array([TRUTH, IDLE]))
    assert 0.6 < own < 1.0  # a remnant of 20 % or less is left
    assert idle < MIN_VAF_RATIO * own
    np.testing.assert_array_equal(judged(np.array([TRUTH, IDLE])), [True, False])
    # What stands behind the pilot's parameters is not looked at.
    behind = np.hstack([np.array([TRUTH, IDLE]), np.full((2, 3), np.nan)])
    np.testing.assert_array_equal(judged(behind), [True, False])
    assert following(np.zeros((0, len(TRUTH))))(np.array([TRUTH, IDLE])).all()


def test_ends_that_do_not_follow_are_left_out_unless_none_does() -> None:
    judged = following(TRUTH[None])
    sets = np.array([IDLE, TRUTH])
    ends = minima_at(sets, np.array([1.0, 2.0]))
    np.testing.assert_array_equal(judged.which(ends), [1])
    none = replace(ends, values=np.array([IDLE, IDLE]))
    np.testing.assert_array_equal(judged.which(none), [0, 1])


def test_an_optimum_that_is_no_pilot_did_not_converge(monkeypatch: pytest.MonkeyPatch) -> None:
    assert fit_of(MLE(), NOMINAL).outcome is Outcome.CONVERGED
    monkeypatch.setattr("pilotid.likelihood.optimum.MIN_VAF_RATIO", 2.0)
    assert fit_of(MLE(), NOMINAL).outcome is Outcome.CONTRADICTED


def test_the_optimum_keeps_the_pilot_of_the_lines() -> None:
    recording = simulate(NOMINAL, np.random.default_rng(3))
    found = maximise_likelihood(recording, NOMINAL.model, np.random.default_rng(1), MLE())
    assert found.is_pilot
    assert found.joint.band == analysis_band(recording.dt, 50.0)
    assert np.shape(found.lines_pilot) == (1, len(TRUTH))
