"""Lateness, and faults that sound recordings seem to have: codes and sizes."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from checks.recorder import FAULTS, bare, noisy, rounded, with_zero

import pilotid
from pilotid.checks.checks import exchanged, remarks
from pilotid.checks.detectors import findings
from pilotid.checks.element_fit import recording_remarks
from pilotid.checks.plant import shifted
from pilotid.datasets import POPULATIONS, SCENARIOS, simulate
from pilotid.datasets.signals import Remnant
from pilotid.estimate.method import identify
from pilotid.methods import method_named
from pilotid.recording.files import load_recording
from pilotid.recording.recording import Recording
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical


def of_zero(number: int) -> Recording:
    rng = np.random.default_rng([1, number])
    return simulate(with_zero(rng), rng)


def codes(recording: Recording) -> set[str]:
    return {remark.code for remark in remarks(recording)}


def test_noise_that_is_in_u_and_not_in_x_makes_no_other_element() -> None:
    rng = np.random.default_rng([2, 4])
    scenario = POPULATIONS["population-usual"].drawn(rng)
    recording = simulate(scenario, rng)
    u = recording.u + 0.6 * np.std(recording.u) * rng.standard_normal(recording.u.shape)
    recording = replace(recording, u=u, controlled_element=scenario.element.name)
    assert not {r.code for r in recording_remarks(recording)} & {
        "output-unrelated",
        "element-differs",
    }


@pytest.mark.parametrize("signal", ["x", "ft", "e"])
def test_the_cure_of_a_signal_that_is_late_against_the_error_mends_it(signal: str) -> None:
    late = FAULTS[f"{signal} late a sample"](simulate(SCENARIOS["nominal"], _rng(3)), _rng(0))
    (found,) = (f for f in findings(late) if f.code == "late-signal")
    assert found.signal == signal
    cured = replace(late, **{signal: shifted(getattr(late, signal), late.dt, found.size)})

    def off(r: Recording) -> FloatArray:
        return (r.e - r.ft + r.x)[:, r.run_in : -2]

    assert np.std(off(cured)) < 0.05 * np.std(off(late))


@pytest.mark.parametrize("number", range(1000, 1006))
def test_with_a_zero_in_the_element_a_late_control_is_named_and_a_sound_one_is_not(
    number: int,
) -> None:
    unnamed = replace(of_zero(number), controlled_element="")
    assert findings(unnamed) == ()
    (found,) = (f for f in findings(FAULTS["u late 20 ms"](unnamed, _rng(0))) if f.grade != "note")
    assert (found.code, found.signal) == ("late-signal", "u")
    assert found.size == pytest.approx(0.02, abs=0.002)


@pytest.mark.parametrize("number", range(1000, 1004))
def test_of_a_late_disturbance_the_control_is_not_blamed(number: int) -> None:
    late = FAULTS["fd late a sample"](of_zero(number), _rng(0))
    (found,) = (f for f in findings(late) if f.grade != "note")
    assert (found.code, found.signal) == ("late-signal", "fd")
    assert found.size == pytest.approx(late.dt, abs=1e-3)


@pytest.mark.parametrize("kept", [("ft",), ()], ids=["ft", "none"])
@pytest.mark.parametrize("source", ["usual", "zero"])
def test_without_forcing_functions_the_named_element_tells_the_time(
    kept: tuple[str, ...], source: str
) -> None:
    rng = _rng(4)
    scenario = with_zero(rng) if source == "zero" else POPULATIONS["population-usual"].drawn(rng)
    whole = simulate(scenario, rng)
    for shift, fault in ((0.0, "sound"), (-0.02, "u late 20 ms"), (-0.1, "u late 100 ms")):
        given = replace(
            bare(FAULTS[fault](whole, _rng(0)), *kept), controlled_element=scenario.element.name
        )
        found = [f for f in findings(given) if f.code == "late-signal"]
        assert [f.size for f in found] == ([pytest.approx(shift, abs=0.002)] if shift else [])


def test_identify_says_once_what_is_wrong_with_the_recording() -> None:
    late = FAULTS["x late a sample"](simulate(SCENARIOS["nominal"], _rng(3)), _rng(0))
    first, second = (pilotid.identify(m, late, "multi") for m in ("mle-white", "arx"))
    for estimate in (first, second):
        told = [remark.code for remark in estimate.remarks]
        assert told.count("late-signal") == 1
        assert estimate.to_dict()["codes"] == told
    assert first.remarks[0] is second.remarks[0]  # worked out once
    inner = identify(method_named("mle-white"), late, pilotid.MODELS["multi"], _rng(1))
    assert "late-signal" not in {remark.code for remark in inner.remarks}


def test_an_element_that_is_not_that_of_the_signals_is_said_by_identify() -> None:
    sound = replace(simulate(SCENARIOS["nominal"], _rng(3)), controlled_element="8/s^2")
    assert {r.code for r in recording_remarks(sound)} == {"element-differs"}
    told = pilotid.identify("mle-white", sound, "multi").remarks
    assert "element-differs" in {remark.code for remark in told}


def test_who_follows_fast_lines_has_not_exchanged_names() -> None:
    """An output that follows the target at all lines, as look-ahead alone can do."""
    sound = simulate(SCENARIOS["nominal"], _rng(3))
    x = sound.x + 0.7 * sound.ft
    omega = 2.0 * np.pi * np.fft.rfftfreq(sound.samples, sound.dt)
    added = np.fft.irfft(-(omega**2) / 4.0 * np.fft.rfft(0.7 * sound.window(sound.ft)))
    u = sound.u.copy()
    u[:, sound.run_in :] += added
    follows = replace(sound, x=x, e=sound.ft - x, u=u)
    assert exchanged(follows) is None
    assert exchanged(replace(sound, e=sound.x, x=sound.e)) is not None


def test_names_that_nothing_but_fast_lines_speak_against_are_a_doubt() -> None:
    rng = np.random.default_rng([1, 1003])
    whole = simulate(POPULATIONS["population-usual"].drawn(rng), rng)
    swapped = exchanged(bare(replace(whole, e=whole.x, x=whole.e), "ft"))
    assert (swapped.code, swapped.grade) == ("exchanged", "doubt")


def test_the_advice_on_exchanged_names_can_be_followed(tmp_path: Path) -> None:
    sound = simulate(SCENARIOS["nominal"], _rng(3))
    table = np.stack([sound.time, sound.ft[0], sound.u[0], sound.e[0]], axis=1)
    path = tmp_path / "state.csv"
    np.savetxt(path, table, delimiter=",", header="t,ft,u,state", comments="")
    wrong = exchanged(load_recording(path, {"x": "state"}))
    assert wrong.endswith("name the column state e in the file")
    path.write_text(path.read_text().replace("state", "e", 1))
    assert exchanged(load_recording(path)) is None


def test_rounding_holds_no_samples_and_lost_ones_are_found() -> None:
    """Coarse decimals keep a slow error at one value for .3 s and more."""
    sound = simulate(SCENARIOS["nominal"], _rng(3))
    coarse = rounded(0.2, "e")(replace(sound, ft=None, fd=None), _rng(0))
    row = coarse.window(coarse.e)[0]
    longest = max(np.diff(np.flatnonzero(np.diff(row))))
    assert longest * coarse.dt > 0.3
    assert "lost-samples" not in codes(coarse)
    fine = rounded(0.01, "e")(replace(sound, ft=None, fd=None), _rng(0))
    assert "lost-samples" in codes(FAULTS["gap of 1 s, last"](fine, _rng(5)))


@pytest.mark.parametrize("number", [2001, 2007, 2011])
def test_a_right_fit_beside_a_slow_remnant_is_not_said_to_explain_nothing(number: int) -> None:
    rng = np.random.default_rng([1, number])
    drawn = POPULATIONS["population-usual"].drawn(rng)
    remnant = Remnant(order=1, frequency=0.3, level=0.8, level_is="ratio")
    scenario = replace(drawn, remnant=remnant)
    estimate = identify(
        method_named("mle"), simulate(scenario, _rng(number)), scenario.model, _rng(number)
    )
    assert np.all(np.abs(estimate.values - scenario.values) < 4.0 * estimate.std_error)
    assert estimate.vaf < 20.0
    assert "little-explained" not in {r.code for r in estimate.remarks}


def test_an_unknown_element_is_a_doubt_only_beside_noise() -> None:
    rng = np.random.default_rng([1, 1001])
    scenario = POPULATIONS["population-usual"].drawn(rng)
    clean = simulate(scenario, rng)
    said = {}
    for share in (0.0, 2e-3):
        given = bare(noisy(share, "x", made=True)(clean, _rng(1001)))
        estimate = identify(method_named("mle"), given, scenario.model, _rng(1001))
        off = np.max(np.abs(estimate.values - scenario.values) / estimate.std_error)
        said[share] = ("element-unknown" in {r.code for r in estimate.remarks}, bool(off > 4.0))
    assert said == {0.0: (False, False), 2e-3: (True, True)}


@pytest.mark.parametrize("folder", ["preview", "preview-gy"])
def test_nothing_is_called_wrong_of_people_who_see_ahead(folder: str) -> None:
    if not (held := os.environ.get("PILOTID_MEASURED")):
        pytest.skip("PILOTID_MEASURED names no folder of recordings")
    names = {"t": "time", "u": "inp", "ft": "ref", "fd": "dis", "x": "state"}
    files = sorted(Path(held, folder).glob("*.csv"))
    assert files
    for file in files:
        told = recording_remarks(load_recording(file, names))
        assert not [r for r in told if r.grade == "wrong"], file.name


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)
