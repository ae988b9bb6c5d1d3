"""Remarks on recordings: nonsense is named, sound recordings are left in peace."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import PILOTS
from nonsense import LATE, PLANTED, SOUND, delayed, named, named_by_a_fit, stepped

from pilotid.checks.checks import remarks
from pilotid.checks.element_fit import SIGNALS, chosen_element
from pilotid.datasets import SCENARIOS, simulate
from pilotid.recording.files import load_recording
from pilotid.recording.recording import Recording
from pilotid.recording.windows import of_runs

pytestmark = pytest.mark.numerical

RECORDINGS = 3


def recording_of(name: str, seed: int) -> Recording:
    return simulate(SCENARIOS[name], np.random.default_rng(seed))


@pytest.mark.parametrize("what", PLANTED)
def test_planted_nonsense_is_named(what: str) -> None:
    plant, code, where = PLANTED[what]
    assert all(
        named(plant(recording_of("nominal", seed)), code, where) for seed in range(RECORDINGS)
    )


def turned(recording: Recording, name: str) -> Recording:
    """Two runs, a signal of the second with the wrong sign."""
    signal = getattr(recording, name) * np.array([[1.0], [-1.0]])
    return replace(recording, **{name: signal})


#: What is wrong with two runs, and a part of what must be said of it, and nothing else.
FAULTS: dict[str, tuple[Callable[[Recording], Recording], str]] = {
    "sign of u": (lambda r: turned(r, "u"), "u has the wrong sign in run 2"),
    "sign of e": (lambda r: turned(r, "e"), "run 2: e is not ft - x: e has the wrong sign; mend"),
    "sign of x": (lambda r: turned(r, "x"), "run 2: e is not ft - x: x has the wrong sign; mend"),
    "radians": (lambda r: replace(r, fd=np.deg2rad(r.fd)), "use --map fd=57.2958*fd"),
    "degrees": (lambda r: replace(r, fd=np.rad2deg(r.fd)), "use --map fd=0.0174533*fd"),
    "gain": (lambda r: replace(r, fd=-r.fd / 3.49), "use --map fd=-3.49*fd"),
    "late": (lambda r: delayed(r, 0.2), "u is 200 ms late against fd"),
    "early": (lambda r: delayed(r, -0.2), "u is 200 ms early against fd"),
    "steps": (stepped, "u has steps of"),
}


@pytest.mark.parametrize("what", FAULTS)
@pytest.mark.parametrize("name", ["multi", "lead2-lag-motion"])
def test_a_fault_is_told_once_and_nothing_is_made_of_what_follows_from_it(
    name: str, what: str
) -> None:
    plant, words = FAULTS[what]
    two_runs = replace(PILOTS[name], runs=2)
    recording = plant(simulate(two_runs, np.random.default_rng(4)))
    recording = replace(recording, controlled_element="")
    (remark,) = remarks(recording)
    assert words in remark
    # No element is drawn from signals that are a fifth of a second apart.
    assert what not in ("late", "early") or chosen_element(recording).origin != SIGNALS


@pytest.mark.parametrize(
    "condition", ["C1", "C6", *(pytest.param(c, marks=pytest.mark.long) for c in ("C2", "C3"))]
)
def test_faults_of_measured_recordings_are_told_alone(measured: Path, condition: str) -> None:
    file = measured / "yaw" / f"ae2224I_measurement_data_subj1_{condition}.mat"
    recording = of_runs(load_recording(file), [1, 2], "")
    assert remarks(recording) == ()
    for plant, words in FAULTS.values():
        (remark,) = remarks(plant(recording))
        assert words in remark


@pytest.mark.parametrize("what", LATE)
def test_a_control_that_comes_late_is_named_by_the_fit(what: str) -> None:
    for seed in range(2):
        assert named_by_a_fit(delayed(recording_of("nominal", seed), LATE[what]))
    assert not named_by_a_fit(recording_of("nominal", 0))


@pytest.mark.parametrize("name", SOUND)
def test_sound_recordings_have_no_remarks(name: str) -> None:
    for seed in range(500, 500 + RECORDINGS):
        assert remarks(recording_of(name, seed)) == ()


@pytest.mark.long
@pytest.mark.parametrize("name", ["adapting-slow", "adapting-fast"])
def test_of_an_element_that_changes_it_is_said_that_it_does(name: str) -> None:
    for seed in range(3):
        (remark,) = remarks(recording_of(name, seed))
        assert remark.code == "element-differs"


def test_rest_is_no_fault() -> None:
    recording = recording_of("nominal", 1)
    u = recording.u.copy()
    # A pilot who lets go: zero for two seconds, twice.
    u[:, 1000:1100] = u[:, 2000:2100] = 0.0
    assert remarks(replace(recording, u=u)) == ()


def test_the_first_thing_that_is_wrong_is_told_and_how_to_mend_it() -> None:
    recording = recording_of("nominal", 2)
    (remark,) = remarks(replace(recording, e=-recording.e))
    assert (remark.code, remark.grade) == ("wrong-sign", "wrong")
    assert remark.endswith("flip it with --map e=-e")
    (remark,) = remarks(replace(recording, e=recording.e + 1.0))
    assert remark.code == "not-the-error"
    assert "check signs, units, offsets" in remark
    assert "ft is 2 times what the others" in remarks(replace(recording, ft=2.0 * recording.ft))[0]
    bent = recording.ft + 0.1 * np.abs(recording.ft)
    assert remarks(replace(recording, ft=bent))[0].code == "not-the-error"
    assert remarks(replace(recording, ft=None, lines={})) == ()


@pytest.mark.parametrize("share", [0.01, 0.03])
def test_channels_with_noise_of_their_own_are_still_e_x_and_ft(share: float) -> None:
    recording = recording_of("nominal", 2)
    rng = np.random.default_rng(5)
    noisy = {}
    for name in ("e", "u", "x"):
        signal = recording.arrays[name]
        noisy[name] = signal + share * np.std(signal) * rng.standard_normal(signal.shape)
    known = recording.with_arrays({**recording.arrays, **noisy})
    assert "wrong" not in {remark.grade for remark in remarks(known)}
    rounded = {
        name: 0.04 * np.std(s) * np.rint(s / (0.04 * np.std(s))) for name, s in noisy.items()
    }
    assert remarks(recording.with_arrays({**recording.arrays, **rounded})) == remarks(known)
    (remark, *_) = remarks(replace(known, x=-known.x))
    assert remark.code == "wrong-sign"
    (remark, *_) = remarks(replace(known, ft=2.0 * recording.ft))
    assert remark.code == "wrong-unit"
    (remark, *_) = remarks(replace(known, e=known.e + 0.1 * np.std(known.e)))
    assert remark.code == "not-the-error"
