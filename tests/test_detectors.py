"""Detectors of what a recorder did: codes and sizes of faults, silence on sound recordings."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from checks.recorder import FAULTS
from helpers import without_remnant

from pilotid.checks.checks import remarks
from pilotid.checks.detectors import (
    Finding,
    band_end,
    copies_among,
    findings,
    fingerprints,
)
from pilotid.datasets import SCENARIOS, simulate
from pilotid.estimate.method import identify
from pilotid.methods import method_named
from pilotid.recording.recording import Recording

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


@cache
def recording_of(name: str, seed: int) -> Recording:
    return simulate(SCENARIOS[name], np.random.default_rng(seed))


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


@pytest.mark.parametrize("name", ["nominal", "single", "white-remnant", "target-only"])
def test_sound_recordings_have_no_findings(name: str) -> None:
    for seed in range(5):
        recording = recording_of(name, seed)
        assert findings(recording) == ()
        assert band_end(recording) == math.inf


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
    scenario = without_remnant(SCENARIOS[name])
    assert "low-pass" not in {
        f.code for f in findings(simulate(scenario, np.random.default_rng(1)))
    }


def test_copies_are_found_among_recordings_and_nothing_else() -> None:
    others = [recording_of("nominal", seed) for seed in range(4)]
    every = [*others, replace(others[2], x=-others[2].x), replace(others[1], u=-others[1].u)]
    said = copies_among([*"abcdef"], [fingerprints(r) for r in every])
    assert {i: [(r.code, r.grade) for r in told] for i, told in said.items()} == {
        i: [("copied-run", "wrong")] for i in (2, 4)
    }


def test_the_third_run_that_copies_the_first_is_named() -> None:
    runs = simulate(replace(SCENARIOS["nominal"], runs=3), np.random.default_rng(7))
    assert not [f for f in findings(runs) if f.code == "copied-run"]
    found = of(replace(runs, u=runs.u[[0, 1, 0]]), "u", "copied-run")
    assert "runs 1 and 3" in found.sentence


def test_gains_and_units_that_differ_are_mended_by_what_is_said() -> None:
    sound = recording_of("nominal", 3)
    wrong = replace(sound, fd=-sound.fd / 3.49, origin={"fd": "d"})
    found = of(wrong, "u", "wrong-unit")
    assert found.size == pytest.approx(-3.49, rel=0.02)
    assert f"--map fd={found.size:.3g}*d" in found.sentence
    (remark,) = (r for r in remarks(replace(sound, x=sound.x / 57.2958)) if r.code == "wrong-unit")
    assert "--map x=57.2958*x" in remark


def test_a_target_that_jumps_is_no_slow_recorder() -> None:
    recording = simulate(SCENARIOS["single"], np.random.default_rng(0))
    wave = np.sin(8.0 * math.pi * recording.time / recording.duration)
    target = 1.5 * np.sign(wave) * np.minimum(1.0, 12.0 * np.abs(wave))
    jumping = replace(recording, ft=target[None], e=target - recording.x, lines={})
    assert "low-pass" not in {finding.code for finding in findings(jumping)}
