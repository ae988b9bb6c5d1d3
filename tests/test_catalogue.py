"""Models of the catalogue and of one's own: recovery, channels on the target, what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import NOMINAL, PILOTS, QUICK, Run, strict, without_remnant

from pilotid.datasets import Scenario, simulate
from pilotid.datasets.bounds import bounds
from pilotid.datasets.experiments import experiment_of
from pilotid.estimate.estimate import Outcome
from pilotid.estimate.method import Method, identify
from pilotid.estimate.warnings import dependent_signals, motionless_input, shared_signals
from pilotid.likelihood.prediction import predict
from pilotid.methods import method_named
from pilotid.methods.fourier import Fourier
from pilotid.methods.mle import MLE
from pilotid.model.catalogue import MODELS, SINGLE, fault_of, model_named
from pilotid.model.channel import Channel
from pilotid.model.factors import Delay, Gain, Lead, Neuromuscular
from pilotid.model.loops import margins, open_loops, pilot_on, pilot_on_each
from pilotid.model.model import PilotModel
from pilotid.recording.files import save_recording
from pilotid.recording.recording import Recording
from pilotid.support.types import InputError
from pilotid.testing import check_estimate

PURSUIT = MODELS["pursuit"]
RATE = MODELS["rate"]

pytestmark = pytest.mark.numerical

NEW = ("lead-lag-motion", "lead-lag-canals", "lead2-lag", "lead2-lag-motion", "pursuit")
FOLLOWING = PILOTS["pursuit"]

#: A pilot with a channel on each signal, of which two would do.
THREE = PilotModel("three", (*PURSUIT.channels, RATE.channels[1]))


def recording_of(scenario: Scenario) -> Recording:
    return simulate(scenario, np.random.default_rng(1))


# ------------------------------------------------------------------------ the new models


@pytest.mark.parametrize("method", ["mle", "fourier"])
@pytest.mark.parametrize("name", NEW)
def test_a_pilot_with_next_to_no_remnant_is_recovered(name: str, method: str) -> None:
    remnant = replace(PILOTS[name].remnant, order=0, level=1e-6, level_is="ratio")
    scenario = replace(PILOTS[name], remnant=remnant)
    estimate = identify(
        method_named(method), recording_of(scenario), scenario.model, np.random.default_rng(2)
    )
    # With next to no remnant it is rounding that decides whether the last step is small enough.
    assert estimate.outcome.usable or estimate.outcome is Outcome.NOT_CONVERGED, estimate.sentence
    # A thousandth of the control in amplitude, from pilots whose bounds are in the report.
    reach = 5.0 * np.sqrt(np.diag(bounds(experiment_of(scenario)).forcing)) + 2e-3 * scenario.values
    assert np.all(np.abs(estimate.values - scenario.values) < reach)


@pytest.mark.parametrize("name", ["lead-lag-motion", "pursuit"])
@pytest.mark.parametrize("method", QUICK, ids=lambda m: m.name)
def test_every_method_takes_the_new_models_or_says_why_not(name: str, method: Method) -> None:
    scenario = PILOTS[name]
    estimate = identify(method, recording_of(scenario), scenario.model, np.random.default_rng(2))
    check_estimate(estimate, method, scenario.model)


def test_factors_that_channels_share_unequally_often_are_applied_as_often() -> None:
    lead, rest = Lead("tlead"), (Delay("tdvis"), Neuromuscular())
    model = PilotModel(
        "uneven",
        (
            Channel("twice", "error", 1, (Gain("Ka"), lead, lead, *rest)),
            Channel("once", "output", -1, (Gain("Kb"), lead, *rest)),
        ),
    )
    prediction = predict(recording_of(NOMINAL), model, 26.0)
    sets = np.array([model.start, 1.3 * model.start])
    expected = prediction.row_spectra(sets)[:, -1]
    np.testing.assert_allclose(
        prediction.residual_spectra(sets),
        expected,
        rtol=1e-9,
        atol=1e-9 * np.abs(expected).max(),
    )


def test_the_published_pilot_in_training_has_the_margins_of_a_pilot() -> None:
    # ... with canals; the same gain on the rate makes the loop unstable.
    scenario = PILOTS["lead2-lag-motion"]
    target, disturbance = margins(scenario.model, scenario.values, scenario.element)
    assert (target.crossover, disturbance.crossover) == pytest.approx((2.18, 3.62), abs=0.01)
    assert (target.phase_margin, disturbance.phase_margin) == pytest.approx((65.5, 46.1), abs=0.1)
    on_rate = PilotModel("rate", (scenario.model.channels[0], RATE.channels[1]))
    with pytest.raises(InputError, match="unstable"):
        simulate(replace(scenario, name="rate", model=on_rate), np.random.default_rng(1))


# ---------------------------------------------------------------- channels on the target


def test_a_channel_on_the_target_is_one_on_error_and_output() -> None:
    omega = np.geomspace(0.1, 30.0, 20)
    visual, target = PURSUIT.response(omega, FOLLOWING.values)
    on_error, on_output = pilot_on(PURSUIT, omega, FOLLOWING.values)
    np.testing.assert_allclose(on_error, visual + target, rtol=1e-12)
    np.testing.assert_allclose(on_output, -target, rtol=1e-12)
    each = pilot_on_each(PURSUIT, PURSUIT.response(omega, FOLLOWING.values))
    np.testing.assert_allclose(each["e"], visual, rtol=1e-12)
    assert not each["x"].any()


def test_the_target_loop_of_pursuit_is_output_over_error_at_the_target_s_lines() -> None:
    recording = recording_of(without_remnant(FOLLOWING))
    lines = np.array(recording.lines["ft"])
    e, x = (np.fft.rfft(recording.window(s))[0, lines] for s in (recording.e, recording.x))
    omega = 2.0 * np.pi * lines / recording.duration
    target, _ = open_loops(PURSUIT, FOLLOWING.values, FOLLOWING.element, omega)
    np.testing.assert_allclose(x / e, target, rtol=1e-8)


def test_a_target_that_was_not_recorded_is_error_and_output_together() -> None:
    recording = recording_of(FOLLOWING)
    without = replace(recording, ft=None)
    np.testing.assert_allclose(without.input("ft"), recording.ft, atol=1e-12)
    first, second = (
        identify(MLE(), r, PURSUIT, np.random.default_rng(2)) for r in (recording, without)
    )
    assert first.outcome.usable
    assert second.values == pytest.approx(first.values, rel=1e-4)


@pytest.mark.parametrize("given", [True, False])
def test_without_a_target_its_channel_has_no_input(given: bool) -> None:
    alone = recording_of(replace(FOLLOWING, target=None))
    alone = alone if given else replace(alone, ft=None)
    expected = "ft does not move, so that the target channel has no input"
    assert motionless_input(alone, PURSUIT) == expected
    assert motionless_input(recording_of(FOLLOWING), PURSUIT) is None


def test_without_a_disturbance_the_channels_follow_one_signal() -> None:
    alone, both = recording_of(replace(FOLLOWING, disturbance=None)), recording_of(FOLLOWING)
    expected = (
        "no disturbance is recorded, so that nothing but their form tells the visual and target"
    )
    for recording in (alone, replace(alone, fd=None)):
        assert (shared_signals(recording, PURSUIT) or "").startswith(expected)
    assert shared_signals(both, PURSUIT) is None
    assert shared_signals(alone, SINGLE) is shared_signals(alone, RATE) is None
    # ... which is said where it shows.
    estimate = identify(MLE(), alone, PURSUIT, np.random.default_rng(2))
    assert any(remark.startswith(expected) for remark in estimate.remarks)


@pytest.mark.parametrize("name", ["fourier", "arx", "sindy"])
def test_three_signals_are_two(name: str) -> None:
    recording = recording_of(FOLLOWING)
    said = method_named(name).objection(recording, THREE)
    assert said == dependent_signals(THREE)
    assert "ft = e + x, so that nothing but their form tells the visual and target and m" in said
    assert method_named(name).objection(recording, PURSUIT) is None


def test_fourier_refuses_a_pilot_outside_any_loop() -> None:
    model = PilotModel("outside", PURSUIT.channels[1:])
    assert "acts on the target alone" in (Fourier().objection(recording_of(FOLLOWING), model) or "")


@pytest.mark.parametrize("order", [1, -1])
def test_fourier_gives_the_responses_on_error_and_target(order: int) -> None:
    # Interpolation between the lines of the other forcing function costs some per cent.
    model = replace(PURSUIT, channels=PURSUIT.channels[::order])
    recording = recording_of(without_remnant(FOLLOWING))
    response = Fourier().first_step(recording, model)
    keys = dict(zip(PURSUIT.keys, FOLLOWING.truth, strict=True))
    true = model.response(response.omega, model.vector(keys))
    inside = (response.omega > 0.6) & (response.omega < 12.0)
    off = np.abs(response.value / true - 1.0)[:, inside]
    assert np.median(off, axis=1).max() < 0.05


# ------------------------------------------------------------------- models of one's own

LAGGED = """
from dataclasses import dataclass, replace
import numpy as np
from pilotid import Channel, PilotModel, MODELS
from pilotid.model.factors import Delay, Gain, Lag, Neuromuscular, Parameter

PARTS = (Gain("Kvis"), Lag("tlag"), Delay("tdvis"), Neuromuscular())
LAGGED = PilotModel("lagged", (Channel("visual", "error", 1, PARTS),))
TAKEN = replace(LAGGED, name="multi")
NAMELESS = replace(LAGGED, name="a b/c")

@dataclass(frozen=True)
class Broken(Gain):
    def response(self, s, values):
        return np.full(s.shape, np.nan)

@dataclass(frozen=True)
class Raising(Gain):
    def response(self, s, values):
        raise ZeroDivisionError("no luck")

BROKEN = PilotModel("broken", (Channel("visual", "error", 1, (Broken("Kvis"), *PARTS[1:])),))
RAISING = PilotModel("raising", (Channel("visual", "error", 1, (Raising("Kvis"), *PARTS[1:])),))
"""


@pytest.fixture
def own(tmp_path: Path) -> Path:
    file = tmp_path / "own.py"
    file.write_text(LAGGED, encoding="utf-8")
    return file


def test_a_model_in_a_file_of_one_s_own(own: Path) -> None:
    model = model_named(f"{own}:LAGGED")
    assert (model.name, model.keys) == ("lagged", ("Kvis", "tlag", "tdvis", "fnm", "dnm"))
    assert model_named(f"{own}:LAGGED(name=mine)").name == "mine"
    assert model_named("pilotid.model.catalogue:SINGLE") is SINGLE


def test_the_command_line_fits_a_model_of_one_s_own(own: Path, run: Run) -> None:
    file = own.with_name("run.csv")
    save_recording(recording_of(PILOTS["gain"]), file)
    answer = run("fit", file, "--model", f"{own}:LAGGED", "--method", "mle-white", "--json", "-")
    assert answer.status == 0, answer.err
    held = strict(answer.out)
    assert held["model"] == "lagged"
    assert list(held["estimates"][0]["parameters"]) == ["Kvis", "tlag", "tdvis", "fnm", "dnm"]
    for command in ("fit", "posterior"):
        refused = run(command, file, "--model", f"{own}:PARTS")
        assert (refused.status, refused.out) == (2, "")
        assert "is no PilotModel" in refused.err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("TAKEN", "has the name 'multi' of another model; give it a name of its own"),
        ("NAMELESS", "model 'a b/c': a name must be of letters, digits"),
        ("PARTS", "is no PilotModel; write NAME = PilotModel"),
        ("NOTHING", "holds no 'NOTHING'"),
        ("LAGGED(gain=1)", "there is no setting 'gain'; its settings are name"),
        ("BROKEN", "the response is not finite at the start values"),
        ("RAISING", "the model gives no response (ZeroDivisionError: no luck)"),
    ],
)
def test_what_is_no_model_is_refused_in_a_sentence(own: Path, text: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        model_named(f"{own}:{text}")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", MODELS)
def test_the_catalogue_passes_the_checks_of_models_of_one_s_own(name: str) -> None:
    assert fault_of(MODELS[name]) == ""
    assert MODELS[name].description
