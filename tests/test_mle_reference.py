"""Instruments from the forcing functions: what they are, and that they need no remnant model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import NOMINAL, differences, fit_of, monte_carlo, recording_of, without_remnant

from pilotid.datasets import scenario_named
from pilotid.datasets.recorder import Recorder
from pilotid.datasets.signals import half_and_half_step
from pilotid.estimate.estimate import Outcome
from pilotid.likelihood.diagnostics import Moments, references
from pilotid.likelihood.search import maximise_likelihood
from pilotid.methods import mle_reference
from pilotid.methods.mle_reference import MLEReference
from pilotid.model.catalogue import ADAPTING
from pilotid.solve.intervals import Profile, profile_intervals
from pilotid.solve.least_squares import Box, minimise
from pilotid.support.numbers import CHI_SQUARED_95

pytestmark = pytest.mark.numerical


def test_references_are_a_recording_without_remnant() -> None:
    quiet = replace(without_remnant(NOMINAL), run_in=40.0)
    recording = recording_of(quiet)
    made = references(recording, quiet.model, quiet.values, quiet.element)
    for name in ("e", "x"):
        signal = recording.window(getattr(recording, name))
        # By the measurement the loop has forgotten how it began.
        error = recording.window(getattr(made, name)) - signal
        assert np.std(error) < 1e-3 * np.std(signal)


def test_the_jacobian_is_that_of_the_moments() -> None:
    recording = recording_of(NOMINAL)
    method = MLEReference()
    found = maximise_likelihood(recording, NOMINAL.model, np.random.default_rng(1), method)
    moments = Moments(found, recording, NOMINAL.element, found.pilot)
    rows = moments.rows(found.pilot[None])[0]
    # The residual falls where the prediction rises.
    slopes = -differences(lambda v: moments.rows(v[None])[0, -1], found.pilot, 1e-5 * found.pilot)
    size = np.abs(rows[:-1]).max(axis=tuple(range(1, rows.ndim)), keepdims=True)
    np.testing.assert_allclose(slopes / size, rows[:-1] / size, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", ["single", "nominal", "target-step"])
def test_a_recording_with_little_remnant_gives_the_truth(name: str) -> None:
    scenario = scenario_named(name)
    quiet = replace(
        scenario, remnant=replace(scenario.remnant, level=1e-3 * scenario.remnant.level)
    )
    estimate = fit_of(MLEReference(), quiet)
    assert estimate.outcome is Outcome.CONVERGED
    assert estimate.values == pytest.approx(quiet.values, rel=0.01)


@pytest.mark.long
@pytest.mark.parametrize(
    "scenario",
    [
        replace(NOMINAL, recorder=Recorder(noise=(0.0, 0.0, 0.01), makes_error=True)),
        replace(NOMINAL, remnant=replace(NOMINAL.remnant, enters="neuromuscular")),
        replace(NOMINAL, target=half_and_half_step(NOMINAL.duration, 2.0)),
    ],
    ids=["noise", "neuromuscular", "step"],
)
def test_it_is_consistent_whatever_the_remnant_and_the_sensors(scenario) -> None:  # type: ignore[no-untyped-def]
    estimates = [e for e in monte_carlo(MLEReference(), scenario, 20) if e.outcome.usable]
    assert len(estimates) >= 19
    truth = scenario.values
    inside = [(e.intervals[:, 0] <= truth) & (truth <= e.intervals[:, 1]) for e in estimates]
    # .95 of 140, less 3.3 of its Monte Carlo errors (parameters of a fit go together in part).
    assert np.mean(inside) > 0.87
    delays = [i for i, key in enumerate(scenario.model.keys) if key in ("tdvis", "fnm", "dnm")]
    z = np.array([((e.values - truth) / e.std_error)[delays] for e in estimates])
    assert np.all(np.abs(z.mean(axis=0)) < 3.3 * z.std(axis=0, ddof=1) / np.sqrt(len(z)))


def test_it_says_where_there_are_no_instruments() -> None:
    recording = recording_of(NOMINAL)
    method = MLEReference()
    assert method.objection(recording, NOMINAL.model) is None
    assert "varies in time" in str(method.objection(recording, ADAPTING))
    bare = replace(recording, ft=None, fd=None, x=-recording.e)
    assert "no forcing function" in str(method.objection(bare, NOMINAL.model))


def test_intervals_end_where_the_deviance_of_the_moments_is_that_sought(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shares = []

    def spied(gram, space, end, *rest, widened, **options) -> Profile:  # type: ignore[no-untyped-def]
        assert not end.curvature.any()  # at a root of the moments it would be rounding's
        profile = profile_intervals(gram, space, end, *rest, widened=widened, **options)
        for which, interval in enumerate(profile.intervals):
            for value in interval:
                held = Box.holding(space, which, value)
                cost = minimise(gram, end.values, held).cost[0]
                shares.append((cost - end.cost[0]) / (CHI_SQUARED_95 * widened))
        return profile

    monkeypatch.setattr(mle_reference, "profile_intervals", spied)
    fit_of(MLEReference(), scenario_named("target-step"))
    assert shares == pytest.approx(np.ones(len(shares)), abs=0.02)
