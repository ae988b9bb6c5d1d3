"""Detectors of what a recorder did: codes and sizes of faults, silence where it did nothing."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from checks.recorder import FAULTS, bare, noisy, rounded, with_zero
from helpers import without_remnant

import pilotid
from pilotid.checks.checks import exchanged, remarks
from pilotid.checks.detectors import Finding, band_end, copies_among, findings, fingerprints
from pilotid.checks.plant import shifted
from pilotid.datasets import POPULATIONS, SCENARIOS, simulate
from pilotid.datasets.signals import Remnant
from pilotid.estimate.method import identify
from pilotid.methods import method_named
from pilotid.recording.files import load_recording
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import known_lines
from pilotid.support.remarks import codes_of
from pilotid.support.types import FloatArray

pytestmark = pytest.mark.numerical


ALWAYS = (
    # fault, signal, code, size, tolerance
    ("u late 20 ms", "u", "late-signal", 0.02, 0.001),
    ("u early 100 ms", "u", "late-signal", -0.1, 0.002),
    ("x late a sample", "x", "late-signal", 0.02, 0.0005),
    ("ft late a sample", "ft", "late-signal", 0.02, 0.0005),
    ("e late a sample", "e", "late-signal", 0.02, 0.0005),
    ("e, x, ft late a sample", "x", "late-signal", 0.02, 0.001),
    ("e = ft - filtered x", "x", "late-signal", 0.045, 0.003),
    ("fd late a sample", "fd", "late-signal", 0.02, 0.002),
    ("u causal 10 Hz", "u", "late-signal", 0.036, 0.002),
    ("all zero-phase 3 Hz", "u", "low-pass", 2.6, 0.4),
    ("u zero-phase 3 Hz", "u", "low-pass", 2.6, 0.4),
    ("all held, every 5th", "x", "low-pass", 10.0, 1e-9),
    ("all linear, every 10th", "u", "low-pass", 5.0, 1e-9),
    ("all cubic, every 5th", "x", "low-pass", 10.0, 1e-9),
    ("0.1 % of x lost", "x", "lost-samples", 5.0, 5.0),
    ("u includes fd", "u", "wrong-unit", 0.0, 0.01),
    ("u times 1.1", "u", "wrong-unit", 1.1, 0.01),
    ("a run copied", "u", "copied-run", 1.0, 0.0),
)


def seeded(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


@cache
def recording_of(name: str, seed: int) -> Recording:
    return simulate(SCENARIOS[name], seeded(seed))


def faulty(fault: str, seed: int = 3) -> Recording:
    return FAULTS[fault](recording_of("nominal", seed), np.random.default_rng(seed + 100))


def of(recording: Recording, signal: str, code: str) -> Finding:
    (found,) = (f for f in findings(recording) if (f.signal, f.code) == (signal, code))
    return found


@pytest.mark.parametrize(("fault", "signal", "code", "size", "within"), ALWAYS)
def test_a_fault_is_named_with_its_size(
    fault: str, signal: str, code: str, size: float, within: float
) -> None:
    found = of(faulty(fault), signal, code)
    assert found.size == pytest.approx(size, abs=within)
    assert found.sentence.startswith((signal, "runs ", "x answers"))


@pytest.mark.parametrize("delay", [0.0, 0.06, 0.12, 0.18])
@pytest.mark.parametrize("name", ["single", "target-only"])
def test_a_control_that_is_far_late_beside_noise_on_x(name: str, delay: float) -> None:
    noise = noisy(0.003, "x")(recording_of(name, 1), seeded(1))
    late = replace(noise, u=shifted(noise.u, noise.dt, -delay), controlled_element="")
    found = [f.size for f in findings(late) if (f.code, f.signal) == ("late-signal", "u")]
    assert found == (pytest.approx([delay], abs=0.01) if delay else [])


def test_a_control_in_a_small_unit_does_not_include_the_disturbance() -> None:
    recording = recording_of("nominal", 3)
    small = recording.with_arrays({"u": 1e-3 * recording.u})
    assert of(small, "u", "wrong-unit").sentence.endswith("--map fd=0.001*fd")


def test_what_a_converter_holds_in_one_run_is_not_lost() -> None:
    time, u = np.arange(2000) * 0.02, seeded(1).standard_normal((2, 2000))
    slow = np.stack([np.sin(0.7 * time), 0.8 * np.sin(0.7 * time + 1.0)])
    steps = np.array([[0.031], [0.0173]])  # a step of each run
    rounded = np.round(slow / steps) * steps
    for lost in (False, True):
        rounded[0, 300:330] = rounded[0, 300] if lost else rounded[0, 300:330]
        said = codes_of(remarks(Recording(dt=0.02, e=rounded, u=u, x=-slow)))
        assert ("lost-samples" in said) == lost


def test_a_control_in_bursts_loses_no_samples_of_its_integral() -> None:
    time, noise = np.arange(60_000) * 1e-3, seeded(1).standard_normal(60_000)
    bursts = 2.0 * np.convolve(noise, np.ones(30) / 30, "same") * (time % 4.0 < 1.0)
    u = np.sin(0.7 * time) + np.sin(1.9 * time) + bursts
    x = 1e-3 * np.cumsum(u)[None, ::20]
    sound = Recording(dt=0.02, e=-x, u=u[None, ::20], x=x)
    spiked = FAULTS["3 spikes of .2 on x"](sound, seeded(1))
    said = ["lost-samples" in [f.code for f in findings(r)] for r in (sound, spiked)]
    assert said == [False, True]
    alone = FAULTS["3 spikes of 5 on u"](sound, seeded(1))
    assert ["lost-samples" in codes_of(remarks(r)) for r in (sound, alone)] == [False, True]


def test_a_shift_explains_that_the_error_is_not_target_less_output() -> None:
    codes = [r.code for r in remarks(faulty("e late a sample"))]
    assert "not-the-error" not in codes
    assert codes[0] == "late-signal"


@pytest.mark.parametrize("fault", ["all zero-phase 3 Hz", "all linear, every 5th"])
def test_a_fit_ends_where_a_filter_left_nothing(fault: str) -> None:
    """Before, delays were off by 20 claimed errors and more."""
    scenario, recording = SCENARIOS["nominal"], faulty(fault)
    rng = np.random.default_rng(3)
    estimate = identify(method_named("mle"), recording, scenario.model, rng)
    assert 8.0 < band_end(recording) < 30.0
    off = (estimate.values - scenario.values) / estimate.std_error
    assert np.abs(off).max() < 4.0
    assert math.sqrt(np.mean(np.square(off))) < 1.6


@pytest.mark.parametrize("name", ["single", "nominal", "target-step"])
def test_a_recording_without_remnant_is_no_low_passed_one(name: str) -> None:
    found = findings(simulate(without_remnant(SCENARIOS[name]), seeded(1)))
    assert "low-pass" not in {f.code for f in found}


def test_copies_are_found_among_recordings_and_nothing_else() -> None:
    others = [recording_of("nominal", seed) for seed in range(4)]
    every = [*others, replace(others[2], x=-others[2].x), replace(others[1], u=-others[1].u)]
    said = copies_among([*"abcdef"], [fingerprints(r) for r in every])
    graded = {i: [(r.code, r.grade) for r in told] for i, told in said.items()}
    assert graded == {i: [("copied-run", "wrong")] for i in (2, 4)}
    runs = simulate(replace(SCENARIOS["nominal"], runs=3), np.random.default_rng(7))
    assert not [f for f in findings(runs) if f.code == "copied-run"]
    found = of(replace(runs, u=runs.u[[0, 1, 0]]), "u", "copied-run")
    assert "runs 1 and 3" in found.sentence


def test_a_target_that_jumps_is_no_slow_recorder() -> None:
    recording = simulate(SCENARIOS["single"], np.random.default_rng(0))
    wave = np.sin(8.0 * math.pi * recording.time / recording.duration)
    target = 1.5 * np.sign(wave) * np.minimum(1.0, 12.0 * np.abs(wave))
    jumping = replace(recording, ft=target[None], e=target - recording.x, lines={})
    assert "low-pass" not in {finding.code for finding in findings(jumping)}
    # Every 21st difference is large where a target steps every 2.1 s.
    target = np.repeat(seeded(0).standard_normal(29), 210)
    s = 2j * np.pi * np.fft.rfftfreq(target.size, 0.01)
    slow = target - np.fft.irfft(np.fft.rfft(target) / (1.0 + s / 2.0) ** 4, target.size)
    assert band_end(Recording(0.01, slow[None], u=slow[None], x=-slow[None])) == math.inf


@pytest.mark.parametrize("change", ["held", "offset", "rounded"])
def test_what_a_fit_allows_for_is_no_doubt(change: str) -> None:
    sound = recording_of("single", 3)
    if change == "held":
        sound = FAULTS["all held, every 2nd"](sound, seeded(0))
    elif change == "offset":
        sound = replace(sound, u=sound.u + 2 * np.std(sound.u))
    else:
        sound = rounded(2.0**-6, "u")(sound, seeded(0))
    remarks = pilotid.identify("mle", sound, "single").remarks
    assert all(remark.grade == "note" for remark in remarks)


# ---------------------------------------------------------- lateness, exchanged names, doubts


def of_zero(number: int) -> Recording:
    rng = np.random.default_rng([1, number])
    return simulate(with_zero(rng), rng)


def test_noise_that_is_in_u_and_not_in_x_makes_no_other_element() -> None:
    rng = np.random.default_rng([2, 4])
    scenario = POPULATIONS["population-usual"].drawn(rng)
    recording = simulate(scenario, rng)
    noise = np.std(recording.u) * rng.standard_normal(recording.u.shape)
    for share, more in ((0.35, ["output-unrelated"]), (0.6, [])):
        noisy = replace(recording, u=recording.u + share * noise)
        noisy = replace(noisy, controlled_element=scenario.element.name)
        assert not {"element-differs", *more} & {r.code for r in pilotid.check(noisy).remarks}


@pytest.mark.parametrize("signal", ["x", "ft", "e"])
def test_the_cure_of_a_signal_that_is_late_against_the_error_mends_it(signal: str) -> None:
    late = FAULTS[f"{signal} late a sample"](recording_of("nominal", 3), seeded(0))
    (found,) = (f for f in findings(late) if f.code == "late-signal")
    assert found.signal == signal
    cured = replace(late, **{signal: shifted(getattr(late, signal), late.dt, found.size)})

    def off(r: Recording) -> FloatArray:
        return (r.e - r.ft + r.x)[:, r.run_in : -2]

    assert np.std(off(cured)) < 0.05 * np.std(off(late))


@pytest.mark.parametrize("number", range(1000, 1006))
def test_beside_a_zero_a_late_control_is_named_and_a_sound_one_is_not(number: int) -> None:
    unnamed = replace(of_zero(number), controlled_element="")
    assert findings(unnamed) == ()
    late = findings(FAULTS["u late 20 ms"](unnamed, seeded(0)))
    (found,) = (f for f in late if f.grade != "note")
    assert (found.code, found.signal) == ("late-signal", "u")
    assert found.size == pytest.approx(0.02, abs=0.002)


def test_aliases_of_a_fast_remnant_make_no_control_early() -> None:
    fast = Remnant(order=1, frequency=100.0, level=0.02, level_is="ratio")
    zero = pilotid.element_named("3.72(s+1.65)/(s(s^2+7.15s+21.6))")
    alone = replace(SCENARIOS["single"], name="aliased", element=zero, target=None, remnant=fast)
    scenario = replace(alone, truth=(2.5, 0.25, 0.17, 10.0, 0.3), dt=0.002)
    exact = simulate(scenario, np.random.default_rng(7))
    kept = {name: signal[:, ::10] for name, signal in exact.arrays.items()}
    recording = exact.with_arrays(kept, dt=0.02, run_in=exact.run_in // 10)
    assert "late-signal" not in codes_of(remarks(recording))


def test_a_control_that_a_simulation_holds_for_a_sample_is_not_early() -> None:
    recording = recording_of("nominal", 3)
    for samples, told in ((0.5, False), (1.5, True)):
        early = replace(recording, u=shifted(recording.u, recording.dt, samples * recording.dt))
        assert ("late-signal" in codes_of(remarks(early))) == told


@pytest.mark.parametrize("number", range(1000, 1004))
def test_of_a_late_disturbance_the_control_is_not_blamed(number: int) -> None:
    late = FAULTS["fd late a sample"](of_zero(number), seeded(0))
    (found,) = (f for f in findings(late) if f.grade != "note")
    assert (found.code, found.signal) == ("late-signal", "fd")
    assert found.size == pytest.approx(late.dt, abs=1e-3)


@pytest.mark.parametrize("kept", [("ft",), ()], ids=["ft", "none"])
@pytest.mark.parametrize("source", ["usual", "zero"])
def test_the_named_element_tells_the_time(kept: tuple[str, ...], source: str) -> None:
    rng = seeded(4)
    scenario = with_zero(rng) if source == "zero" else POPULATIONS["population-usual"].drawn(rng)
    whole = simulate(scenario, rng)
    for shift, fault in ((0.0, "sound"), (-0.02, "u late 20 ms"), (-0.1, "u late 100 ms")):
        given = bare(FAULTS[fault](whole, seeded(0)), *kept)
        given = replace(given, controlled_element=scenario.element.name)
        found = [f for f in findings(given) if f.code == "late-signal"]
        assert [f.size for f in found] == ([pytest.approx(shift, abs=0.002)] if shift else [])


def test_identify_says_once_what_is_wrong_with_the_recording() -> None:
    late = FAULTS["x late a sample"](recording_of("nominal", 3), seeded(0))
    assert remarks(late) is remarks(late)  # worked out once
    first, second = (pilotid.identify(m, late, "multi") for m in ("mle-white", "arx"))
    for estimate in (first, second):
        told = [remark.code for remark in estimate.remarks]
        assert told.count("late-signal") == 1
        assert estimate.to_dict()["codes"] == told
    assert first.remarks[0] == second.remarks[0]
    inner = identify(method_named("mle-white"), late, pilotid.MODELS["multi"], seeded(1))
    assert "late-signal" not in {remark.code for remark in inner.remarks}


def test_an_element_that_is_not_that_of_the_signals_is_said_by_identify() -> None:
    sound = replace(recording_of("nominal", 3), controlled_element="8/s^2")
    assert {r.code for r in pilotid.check(sound).remarks} == {"element-differs"}
    assert "element-differs" in codes_of(pilotid.identify("mle-white", sound, "multi").remarks)


def test_who_follows_fast_lines_has_not_exchanged_names() -> None:
    """An output that follows the target at all lines, as look-ahead alone can do."""
    sound = recording_of("nominal", 3)
    x = sound.x + 0.7 * sound.ft
    omega = 2.0 * np.pi * np.fft.rfftfreq(sound.samples, sound.dt)
    added = np.fft.irfft(-(omega**2) / 4.0 * np.fft.rfft(0.7 * sound.window(sound.ft)))
    u = sound.u.copy()
    u[:, sound.run_in :] += added
    follows = replace(sound, x=x, e=sound.ft - x, u=u)
    assert exchanged(follows) is None
    for lines in ({}, {"ft": None}):  # without a target u and fd seemed to have the wrong sign
        assert exchanged(replace(sound, e=sound.x, x=sound.e, **lines)).grade == "wrong"


def test_names_that_nothing_but_fast_lines_speak_against_are_a_doubt() -> None:
    rng = np.random.default_rng([1, 1014])
    whole = simulate(POPULATIONS["population-usual"].drawn(rng), rng)
    swapped = exchanged(bare(replace(whole, e=whole.x, x=whole.e), "ft"))
    assert (swapped.code, swapped.grade) == ("exchanged", "doubt")


def test_the_advice_on_exchanged_names_can_be_followed(tmp_path: Path) -> None:
    sound = recording_of("nominal", 3)
    table = np.stack([sound.time, sound.ft[0], sound.u[0], sound.e[0]], axis=1)
    path = tmp_path / "state.csv"
    np.savetxt(path, table, delimiter=",", header="t,ft,u,state", comments="")
    wrong = exchanged(load_recording(path, {"x": "state"}))
    assert wrong.endswith("name the column state e in the file")
    path.write_text(path.read_text().replace("state", "e", 1))
    assert exchanged(load_recording(path)) is None


def test_rounding_holds_no_samples_and_lost_ones_are_found() -> None:
    """Coarse decimals keep a slow error at one value for .3 s and more."""
    sound = recording_of("nominal", 3)
    coarse = rounded(0.2, "e")(replace(sound, ft=None, fd=None), seeded(0))
    row = coarse.window(coarse.e)[0]
    longest = max(np.diff(np.flatnonzero(np.diff(row))))
    assert longest * coarse.dt > 0.3
    assert "lost-samples" not in codes_of(remarks(coarse))
    fine = rounded(0.01, "e")(replace(sound, ft=None, fd=None), seeded(0))
    assert "lost-samples" in codes_of(remarks(FAULTS["gap of 1 s, last"](fine, seeded(5))))


@pytest.mark.parametrize("cut", [0, 37], ids=["whole periods", "no lines"])
@pytest.mark.parametrize("number", [2001, 2007, 2011])
def test_a_right_fit_beside_a_slow_remnant_explains_something(number: int, cut: int) -> None:
    rng = np.random.default_rng([1, number])
    drawn = POPULATIONS["population-usual"].drawn(rng)
    remnant = Remnant(order=1, frequency=0.3, level=0.8, level_is="ratio")
    scenario = replace(drawn, remnant=remnant)
    recording = simulate(scenario, seeded(number))
    kept = {name: s[:, : s.shape[1] - cut] for name, s in recording.arrays.items()}
    recording = recording.with_arrays(kept, lines={})
    assert bool(known_lines(recording)) is not bool(cut)
    estimate = identify(method_named("mle"), recording, scenario.model, seeded(number))
    assert np.all(np.abs(estimate.values - scenario.values) < 4.0 * estimate.std_error)
    assert estimate.vaf < 20.0
    assert ("little-explained", "wrong") not in {(r.code, r.grade) for r in estimate.remarks}


def test_an_unknown_element_is_a_doubt_only_beside_noise() -> None:
    rng = np.random.default_rng([1, 1001])
    scenario = POPULATIONS["population-usual"].drawn(rng)
    clean = simulate(scenario, rng)
    said = {}
    for share in (0.0, 2e-3):
        given = bare(noisy(share, "x", made=True)(clean, seeded(1001)))
        estimate = identify(method_named("mle"), given, scenario.model, seeded(1001))
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
        told = pilotid.check(load_recording(file, names)).remarks
        assert not [r for r in told if r.grade == "wrong"], file.name


def in_run(recording: Recording, run: int, fault: str, seed: int = 1) -> Recording:
    """A recording of which one run has a fault."""
    whole, other = recording, FAULTS[fault](recording, seeded(seed))
    rows = np.arange(whole.runs)[:, None] == run
    changed = {n: np.where(rows, getattr(other, n), getattr(whole, n)) for n in ("e", "u", "x")}
    return replace(whole, **changed)


@pytest.mark.parametrize("lines", [("ft", "fd"), ("ft",)], ids=["fd", "no fd"])
@pytest.mark.parametrize(
    ("fault", "code"), [("u early 100 ms", "late-signal"), ("u late 100 ms", "late-signal")]
)
def test_one_run_that_is_late_is_named(lines: tuple[str, ...], fault: str, code: str) -> None:
    scenario = replace(SCENARIOS["target-only" if lines == ("ft",) else "nominal"], runs=4)
    sound = bare(simulate(scenario, seeded(3)), *lines)
    assert remarks(sound) == ()
    (told,) = remarks(in_run(sound, 2, fault))
    assert told.code == code
    assert "run 3" in told
    assert "100 ms" in told or lines == ("ft",)


def test_one_run_of_another_gain_is_named_and_nothing_else() -> None:
    sound = simulate(replace(SCENARIOS["nominal"], runs=4), seeded(3))
    told = [*remarks(in_run(sound, 1, "u times 1.2"))]
    assert [r.code for r in told] == ["wrong-unit"]
    assert told[0].startswith("run 2: ")
    two = [*remarks(in_run(in_run(sound, 1, "u times 1.2"), 2, "u late 100 ms"))]
    assert [r.code for r in two] == ["late-signal", "wrong-unit"]
    assert two[0].startswith("run 3: ")
    assert two[1].startswith("run 2: ")
    scaled = replace(sound, fd=1.1 * sound.input("fd"))
    assert [r.code for r in remarks(scaled)] == ["wrong-unit"]


@pytest.mark.parametrize("forced", [True, False])
def test_a_control_of_other_runs_has_no_wrong_sign(forced: bool) -> None:
    scenario = replace(SCENARIOS["nominal" if forced else "target-only"], runs=3)
    sound = simulate(scenario, seeded(4))
    told = remarks(replace(sound, u=np.roll(sound.u, 1, axis=0)))
    assert [r.code for r in told] == ["output-unrelated"]
    two = remarks(replace(sound, u=sound.u[[1, 0, 2]])) if forced else ()
    assert not forced or "run 1, 2" in two[0]


def test_a_code_for_missing_values_that_stands_for_seconds_is_found() -> None:
    sound = bare(simulate(replace(SCENARIOS["target-only"], runs=2), seeded(4)), "ft")
    u = sound.u.copy()
    u[:, 1000:1150] = -9999.0
    first = remarks(replace(sound, u=u))[0]
    assert first.code == "lost-samples"
    assert "-9999" in first
