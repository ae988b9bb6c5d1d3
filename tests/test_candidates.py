"""What can be a pilot: a stable loop; and what a lag leaves that outlasts the run-in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from checks.published import LED, preview_runs
from checks.strata import of_stratum
from golden.golden import POSITION
from helpers import PILOTS, SINGLE_LOOP, fit_of

from pilotid import element_named, identify
from pilotid.datasets import Scenario
from pilotid.datasets.signals import Remnant
from pilotid.likelihood.optimum import best_of
from pilotid.methods import method_named
from pilotid.model.loops import are_stable, pilot_on
from pilotid.recording.files import load_recording
from pilotid.support.remarks import codes_of

pytestmark = pytest.mark.numerical
#: A lag of 3.6 s after 3 s of run-in.
SLOW = replace(POSITION, name="slow", truth=(7.2, 0.2, 3.6, 0.25, 12.0, 0.35), run_in=3.0)


def winding(scenario: Scenario, values: np.ndarray) -> int:
    """Unstable poles of a loop, from the turn of its characteristic function on a fine grid."""
    omega = np.concatenate(([0.0], np.geomspace(1e-5, 1e4, 40_000)))
    element, s = scenario.element, 1j * omega
    answer = sum(pilot_on(scenario.model, omega, values))
    turning = np.polyval(element.denominator, s)
    turning = turning + np.polyval(element.numerator, s) * np.exp(-element.delay * s) * answer
    turn = np.unwrap(np.angle(turning))
    degree = len(element.denominator) - 1
    return round(float(degree - (turn[-1] - turn[0]) / (np.pi / 2.0)) / 2.0)


@pytest.mark.parametrize("scenario", PILOTS.values(), ids=PILOTS)
def test_stable_loops_are_those_without_unstable_poles(scenario: Scenario) -> None:
    rng = np.random.default_rng(1)
    model = scenario.model
    sets = scenario.values * np.exp(0.6 * rng.normal(size=(20, len(model.keys))))
    sets = np.clip(sets, model.lower, model.upper)
    expected = [winding(scenario, values) == 0 for values in sets]
    assert are_stable(model, sets, scenario.element).tolist() == expected


@pytest.mark.parametrize("method", ["mle", "fourier"])
def test_a_search_does_not_go_to_the_inverse_of_the_element(measured: Path, method: str) -> None:
    recording = preview_runs(measured / "preview-gy", "gy", "fo")
    for seed in (1, 2):
        estimate = identify(recording, LED, method, seed)
        assert estimate.outcome.usable
        assert estimate.values[LED.keys.index("Kvis")] < 5.0
        assert estimate.vaf > 50.0


def test_what_explains_far_less_than_the_lines_pilot_is_not_preferred(measured: Path) -> None:
    recording = load_recording(measured / "yaw" / "ae2224I_measurement_data_subj6_C1.mat")
    # Of half of the seeds an optimum with a motion delay of .10 s was likelier by 125.
    assert all(identify(recording, "multi", "mle", seed).vaf > 65.0 for seed in (2, 4))


@pytest.mark.parametrize("name", [pytest.param("preview", marks=pytest.mark.long), "pursuit"])
def test_what_is_no_pilot_did_not_converge(measured: Path, name: str) -> None:
    recording = preview_runs(measured / "preview-gy", "gy", "fo")
    estimate = identify("mle", recording, name)
    assert not estimate.outcome.usable or estimate.vaf > 40.0


def test_a_slow_remnant_that_hides_the_simulated_response_refuses_no_pilot() -> None:
    slow = Remnant(order=2, frequency=0.1, level=20.0)
    truth = (0.9, 0.1, 0.2, 12.0, 0.35)
    element = element_named("3/s")
    scenario = replace(SINGLE_LOOP, name="slow remnant", remnant=slow, truth=truth, element=element)
    for fit in (fit_of(method_named("mle"), scenario, i) for i in range(3)):
        assert fit.outcome.usable
        assert fit.vaf < 1.0
        assert np.abs((fit.values - truth) / fit.std_error).max() < 4.0
        (said,) = (remark for remark in fit.remarks if remark.code == "little-explained")
        assert said.grade == "note"


@pytest.mark.parametrize("method", ["mle", pytest.param("mle-reference", marks=pytest.mark.long)])
def test_the_decay_of_a_lag_that_outlasts_the_run_in_is_no_bias(method: str) -> None:
    fits = [fit_of(method_named(method), SLOW, i) for i in range(8)]
    errors = np.array([(fit.values - SLOW.values) / fit.std_error for fit in fits])
    # The median of eight has a standard error of about .45 claimed errors.
    assert np.abs(np.median(errors, axis=0)).max() < 1.5
    if method == "mle":
        assert all("slow-lag" in codes_of(fit.remarks) for fit in fits)


@pytest.mark.parametrize("number", [61029, 61120, 994141])
def test_a_quick_lag_is_not_taken_for_one_that_outlasts_the_run_in(number: int) -> None:
    # A lead with a lag of 3 to 30 s is much like a gain, and its free decay fits the remnant.
    recording, model, truth = of_stratum("other-models", number)
    estimate = identify(recording, model)
    assert abs(np.log(estimate["tlag"].value / truth["tlag"])) < np.log(1.5)


def test_a_lag_that_ends_as_a_quick_one_has_no_free_decay() -> None:
    recording, model, truth = of_stratum("other-models", 1020037)
    low, high = identify(recording, model).intervals[model.index["tdt"]]
    assert low < truth["tdt"] < high


def test_a_band_that_is_asked_for_is_not_widened() -> None:
    bands = {fit_of(method_named(f"mle(band={band})"), SINGLE_LOOP).band for band in (15, 26)}
    highest = sorted(band.highest for band in bands if band is not None)
    assert highest[0] < 15.0 < highest[1] < 26.0


@pytest.mark.parametrize(("dispersion", "best"), [(1.0, 0), (1.2, 1), (3.0, 2)])
def test_of_optima_as_likely_the_one_that_explains_most_where_scores_scatter(
    dispersion: float, best: int
) -> None:
    shares = [(-100.0, 0.2), (-98.0, 0.4), (-92.0, 0.5), (-80.0, 0.9)]
    optima: list[Any] = [
        SimpleNamespace(criterion=criterion, explained=share, dispersion=dispersion, is_slow=False)
        for criterion, share in shares
    ]
    assert optima.index(best_of(optima)) == best
    slow = SimpleNamespace(criterion=-103.0, explained=0.2, dispersion=1.0, is_slow=True)
    assert best_of([slow, *optima]) is optima[0]  # as likely without a lag that outlasts the run-in
    assert best_of([slow, *optima[2:]]) is slow
