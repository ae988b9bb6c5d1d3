"""Estimates that are used: on recordings never seen, and from files."""

from __future__ import annotations

import json
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_toeplitz

from pilotid import (
    MODELS,
    Channel,
    Delay,
    Estimate,
    Gain,
    InputError,
    PilotModel,
    Recording,
    identify,
    load_estimate,
    save,
    simulate,
)
from pilotid.cli.main import main
from pilotid.datasets import SCENARIOS
from pilotid.recording.files import save_recording
from pilotid.recording.windows import of_runs

RECORDING = simulate("nominal", 3)


@pytest.fixture(scope="module")
def runs() -> Recording:
    return simulate(replace(SCENARIOS["single"], runs=4), np.random.default_rng(5))


@pytest.fixture(scope="module")
def fitted(runs: Recording) -> Estimate:
    return identify(of_runs(runs, [1, 3, 4], ""), "single")


def response(recording: Recording, estimate: Estimate) -> np.ndarray:
    """The single-loop pilot's response to one run, pre-history included, by a plain transform."""
    e = recording.input("e")[0]
    k, lead, delay, f, d = estimate.values
    n = 8 * e.size
    s = 2j * np.pi * np.fft.rfftfreq(n, recording.dt)
    h = k * (1 + lead * s) * np.exp(-delay * s) * f**2 / (f**2 + 2 * d * f * s + s**2)
    window = recording.u.shape[1]
    return np.asarray(np.fft.irfft(h * np.fft.rfft(e, n), n)[: e.size][-window:])


@pytest.mark.numerical
def test_the_response_to_a_run_never_seen_is_that_of_the_transfer_function(
    runs: Recording, fitted: Estimate
) -> None:
    own = of_runs(runs, [2], "")
    frame = fitted.simulate(own)
    assert [*frame] == ["run", "time", "control", "simulated"]
    scored = np.isin(np.round(own.time / own.dt), np.round(frame["time"] / own.dt))
    expected, control = response(own, fitted)[scored], own.u[0, scored]
    assert frame["control"].to_numpy() == pytest.approx(control, abs=1e-9 * control.std())
    left = (control - expected).std()
    assert frame["simulated"].std() == pytest.approx(expected.std(), rel=5e-3)
    found = (frame["control"] - frame["simulated"]).std(ddof=0)
    assert found == pytest.approx(left, rel=5e-3)
    assert fitted.score(own).vaf == pytest.approx(100 * (1 - left**2 / control.var()), abs=0.3)


@pytest.mark.numerical
def test_the_log_score_is_that_of_the_remnant_known_before(
    runs: Recording, fitted: Estimate
) -> None:
    own = of_runs(runs, [2], "")
    frame = fitted.predict(own)
    errors = (frame["control"] - frame["predicted"]).to_numpy()
    std = frame["std"].iloc[0]
    by_hand = -0.5 * np.sum(np.log(2 * np.pi * std**2) + errors**2 / std**2)
    assert fitted.score(own).log_score == pytest.approx(by_hand, rel=1e-12)
    # Wiener's one-step variance of the remnant's own density, by its normal equations.
    omega, density = fitted.remnant.omega, fitted.remnant.density
    dt = frame["time"].iloc[1] - frame["time"].iloc[0]
    lags = np.cos(np.outer(np.arange(60) * dt, omega)) @ density * (omega[1] - omega[0])
    variance = lags[0] - lags[1:] @ solve_toeplitz(lags[:-1], lags[1:])
    assert std**2 == pytest.approx(variance, rel=1e-3)
    # The true pilot left the same remnant in this run.
    assert errors.std() == pytest.approx(std, rel=0.1)
    again = fitted.score(own, of_runs(runs, [1, 3, 4], ""))
    assert again.log_score == pytest.approx(by_hand, rel=0.02)


@pytest.mark.numerical
def test_a_wrong_pilot_scores_worse_on_every_run(runs: Recording) -> None:
    for run in range(1, 5):
        others = of_runs(runs, [own for own in range(1, 5) if own != run], "")
        own = of_runs(runs, [run], "")
        estimate = identify(others, "single", "mle-white")
        late = replace(estimate, values=estimate.values * [1, 1, 1.3, 1, 1])
        apart = estimate.score(own, others).log_score - late.score(own, others).log_score
        assert apart > 5.0
        assert estimate.score(own).vaf > late.score(own).vaf


def test_an_estimate_without_a_remnant_asks_for_what_it_was_fitted_to() -> None:
    estimate = identify(RECORDING, "multi", "fourier")
    assert np.isnan(estimate.score(RECORDING).log_score)
    with pytest.raises(InputError, match="no model of the remnant; give the recording"):
        estimate.predict(RECORDING)
    assert [*estimate.predict(RECORDING, RECORDING)][3:] == ["predicted", "std"]
    still = identify(replace(RECORDING, e=np.zeros_like(RECORDING.e)), "multi")
    with pytest.raises(InputError, match="has no values: not applicable"):
        still.simulate(RECORDING)


def equal(one: object, two: object) -> bool:
    """Whether two parts of estimates are equal to the bit."""
    if isinstance(one, np.ndarray):
        return isinstance(two, np.ndarray) and np.array_equal(one, two, equal_nan=one.dtype != bool)
    if is_dataclass(one) and not isinstance(one, PilotModel):
        names = [f.name for f in fields(one)]
        return type(one) is type(two) and all(
            equal(getattr(one, n), getattr(two, n)) for n in names
        )
    both_nan = isinstance(one, float) and one != one and two != two
    return both_nan or (one == two and str(type(one)) == str(type(two)))


@pytest.mark.numerical
@pytest.mark.parametrize(
    ("model", "method"),
    [
        (MODELS["multi"], "mle"),
        (MODELS["multi"], "bayes"),
        (MODELS["multi"], "fourier"),
        (MODELS["multi"].with_fixed(fnm=12.0), "arx"),
        (MODELS["multi"].with_bounds(tlead=(0.1, 9.0)), "mle-white"),
        (MODELS["adapting"], "mle-white"),
        (MODELS["crossover"], "mle"),
    ],
    ids=lambda given: getattr(given, "name", given),
)
def test_a_loaded_estimate_is_the_saved_one_to_the_bit(
    model: PilotModel, method: str, tmp_path: Path
) -> None:
    estimate = identify(RECORDING, model, method)
    save(estimate, tmp_path / "e.json")
    again = load_estimate(tmp_path / "e.json")
    assert str(again) == str(estimate)
    if response := estimate.frequency_response:  # without covariances, but with their diagonal
        np.testing.assert_allclose(again.frequency_response.std, response.std, rtol=1e-12)
        whole = replace(again.frequency_response, covariance=response.covariance)
        again = replace(again, frequency_response=whole)
    unequal = [
        f.name
        for f in fields(Estimate)
        if not equal(getattr(estimate, f.name), getattr(again, f.name))
    ]
    assert not unequal


def test_an_estimate_is_loaded_from_what_fit_writes(tmp_path: Path) -> None:
    file, out = tmp_path / "r.csv", tmp_path / "e.json"
    save_recording(RECORDING, file)
    command = ["fit", str(file), "--method", "mle", "--method", "fourier", "--json", str(out)]
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert not ended.value.code
    with pytest.raises(InputError, match=r"e.json: holds 2 estimates, of mle, fourier; name the"):
        load_estimate(out)
    printed = json.loads(out.read_text())["estimates"][0]
    loaded = load_estimate(out, "mle")
    assert loaded["tdvis"].to_dict() == printed["parameters"]["tdvis"]
    assert loaded.score(RECORDING).vaf == pytest.approx(printed["vaf"], abs=0.05)
    assert load_estimate(out, "fourier").frequency_response is not None


def test_what_is_no_estimate_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "e.json"
    mine = PilotModel("mine", (Channel("visual", "error", 1, (Gain("K"), Delay())),))
    estimate = identify(RECORDING, mine, "mle-white")
    save(estimate, file)
    with pytest.raises(InputError, match=r"model mine is none of the catalogue; give it"):
        load_estimate(file)
    assert load_estimate(file, model=mine).model == mine
    with pytest.raises(InputError, match=r"is an estimate of K, tdvis, not of model single"):
        load_estimate(file, model=MODELS["single"])
    for text in ("{", "[1]", '{"estimates": [{"method": "mle"}]}', '{"estimates": 3}'):
        file.write_text(text)
        with pytest.raises(InputError, match="holds no estimate; give a file"):
            load_estimate(file)
