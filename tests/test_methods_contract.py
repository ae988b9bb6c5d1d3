"""What every method promises, checked for each that is registered."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import FrozenInstanceError, fields, replace
from functools import cache

import numpy as np
import pytest
from helpers import NOMINAL, QUICK, SINGLE_LOOP

from pilotid.datasets import simulate
from pilotid.estimate.estimate import Estimate, Outcome
from pilotid.estimate.method import Method, identify
from pilotid.methods import METHODS
from pilotid.model.catalogue import MULTI, SINGLE
from pilotid.recording.recording import SIGNALS, Recording
from pilotid.testing import (
    DIFFICULT,
    bare,
    check_estimate,
    check_settings,
    control_is_noise,
    recording_for,
    tiny,
)

pytestmark = pytest.mark.numerical

MODELS = {"single": SINGLE, "multi": MULTI}
SCENARIOS = {"single": SINGLE_LOOP, "multi": NOMINAL}


every_method = pytest.mark.parametrize("method", QUICK, ids=lambda m: m.name)
every_model = pytest.mark.parametrize("model", MODELS)
recording_of = cache(recording_for)


@cache
def fitted(method: Method, model: str) -> Estimate:
    return identify(method, recording_of(model), MODELS[model], np.random.default_rng(2))


@pytest.mark.parametrize("method", METHODS.values(), ids=lambda m: m.name)
def test_a_method_is_a_frozen_dataclass_of_settings(method: Method) -> None:
    check_settings(method)
    assert METHODS[method.name] is method
    for setting in fields(method):
        assert f"{setting.name}={getattr(method, setting.name)!r}" in repr(method)
        with pytest.raises(FrozenInstanceError):
            setattr(method, setting.name, None)


@every_method
@every_model
def test_an_estimate_is_sound(method: Method, model: str) -> None:
    estimate = fitted(method, model)
    check_estimate(estimate, method, MODELS[model])
    assert 0.0 <= estimate.vaf <= 100.0
    assert estimate.seconds >= 0.0
    assert estimate.outcome.usable, estimate.sentence


@every_method
@every_model
def test_values_come_in_the_model_s_order(method: Method, model: str) -> None:
    # Names are positions here.  A pilot with hardly any remnant, no two of whose parameters
    # are within a third of each other: any two that change places are found.
    truth = {"single": (0.26, 1.7, 0.4, 10.0, 0.64), "multi": (0.2, 2.6, 0.4, 1.3, 0.15, 9.0, 0.6)}
    pilot = replace(
        SCENARIOS[model],
        truth=truth[model],
        remnant=replace(SCENARIOS[model].remnant, level=0.02),
    )
    recording = simulate(pilot, np.random.default_rng(1))
    estimate = identify(method, recording, MODELS[model], np.random.default_rng(2))
    assert estimate.outcome.usable, estimate.sentence
    assert estimate.values == pytest.approx(pilot.values, rel=0.13)


@every_method
@every_model
def test_the_same_generator_gives_the_same_answer(method: Method, model: str) -> None:
    # To the bit: that is promised on one machine, and docs/guide/methods.md says what elsewhere.
    first = fitted(method, model)
    again = identify(method, recording_of(model), MODELS[model], np.random.default_rng(2))
    assert again.outcome is first.outcome
    for name in ("values", "covariance", "intervals"):
        assert getattr(again, name).tobytes() == getattr(first, name).tobytes()


@every_method
def test_the_recording_stays_as_it_is(method: Method) -> None:
    recording = recording_of("single")
    before = {n: getattr(recording, n).tobytes() for n in SIGNALS}
    identify(method, recording, SINGLE, np.random.default_rng(3))
    for name, content in before.items():
        signal = getattr(recording, name)
        assert signal.tobytes() == content
        assert not signal.flags.writeable


@every_method
@pytest.mark.parametrize(
    ("model", "spoil"),
    [
        pytest.param(
            *(model, spoil),
            # Of no pilot a search takes seconds.
            marks=[pytest.mark.long] if (model, spoil) == ("multi", control_is_noise) else [],
            id=f"{spoil.__name__}-{model}",
        )
        for model, spoil in itertools.product(MODELS, DIFFICULT)
    ],
)
def test_a_difficult_recording_gives_an_outcome_and_no_exception(
    method: Method, model: str, spoil: Callable[[Recording], Recording]
) -> None:
    # Which outcome is for the method to say, and may be for rounding; that it is one is not.
    recording = spoil(recording_of(model))
    estimate = identify(method, recording, MODELS[model], np.random.default_rng(2))
    check_estimate(estimate, method, MODELS[model])


@every_method
@every_model
def test_without_forcing_functions_a_method_objects_or_does_without(
    method: Method, model: str
) -> None:
    recording = bare(recording_of(model))
    estimate = identify(method, recording, MODELS[model], np.random.default_rng(2))
    check_estimate(estimate, method, MODELS[model])
    if method.objection(recording, MODELS[model]):
        assert estimate.outcome is Outcome.NOT_APPLICABLE
    else:
        assert estimate.outcome.usable, estimate.sentence


@every_method
@every_model
def test_the_scale_of_all_signals_changes_nothing(method: Method, model: str) -> None:
    estimate = fitted(method, model)
    small = identify(method, tiny(recording_of(model)), MODELS[model], np.random.default_rng(2))
    assert small.outcome is estimate.outcome
    assert small.values == pytest.approx(estimate.values, rel=1e-3)
