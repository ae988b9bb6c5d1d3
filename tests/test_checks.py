"""Remarks on recordings: nonsense is named, sound recordings are left in peace."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import PILOTS

from pilotid.checks.checks import remarks
from pilotid.checks.detectors import band_end, findings
from pilotid.checks.element_fit import chosen_element
from pilotid.datasets import SCENARIOS, simulate
from pilotid.estimate.method import identify
from pilotid.methods import method_named
from pilotid.recording.files import load_recording
from pilotid.recording.recording import Recording
from pilotid.recording.windows import of_runs
from pilotid.support.remarks import codes_of

pytestmark = pytest.mark.numerical

RECORDINGS = 3
SOUND = {
    name: scenario
    for name, scenario in SCENARIOS.items()
    if scenario.violation is None and scenario.change is None and scenario.recorder is None
}
ALL = ("e", "u", "x", "ft", "fd")


def delayed(recording: Recording, seconds: float) -> Recording:
    """The control recorded too late; its end comes first."""
    return replace(recording, u=np.roll(recording.u, round(seconds / recording.dt), axis=1))


def repeated(recording: Recording) -> Recording:
    """Two seconds of all signals recorded twice."""
    begin, length = recording.run_in + 1500, round(2.0 / recording.dt)

    def twice(signal: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
        return np.concatenate([signal[:, : begin + length], signal[:, begin:-length]], axis=1)

    return replace(recording, **{name: twice(getattr(recording, name)) for name in ALL})


def dropped(recording: Recording, names: tuple[str, ...]) -> Recording:
    """Twenty seconds lost."""
    begin, length = recording.run_in + 1000, round(20.0 / recording.dt)
    changed = {name: getattr(recording, name).copy() for name in names}
    for signal in changed.values():
        signal[:, begin : begin + length] = 0.0
    return replace(recording, **changed)


def spoilt(recording: Recording) -> Recording:
    """One sample holds a code for a missing value."""
    u = recording.u.copy()
    u[0, recording.run_in + 777] = -9999.0
    return replace(recording, u=u)


def clipped(recording: Recording) -> Recording:
    """A control that saturates almost always."""
    return replace(recording, u=np.clip(recording.u, *np.quantile(recording.u, (0.45, 0.55))))


def in_one_run(recording: Recording, change: Callable[[Recording], Recording]) -> Recording:
    """The recording with three more runs like it, and a change in the third of them."""
    runs = [simulate(SCENARIOS["nominal"], np.random.default_rng([9, i])) for i in range(3)]
    runs = [recording, runs[0], change(runs[1]), runs[2]]
    signals = {name: np.concatenate([getattr(r, name) for r in runs]) for name in ALL}
    return replace(recording, **signals)


def appended(recording: Recording) -> Recording:
    """Two runs, one behind the other as one."""
    other = simulate(SCENARIOS["nominal"], np.random.default_rng([11, recording.samples]))
    runs = [{name: r.window(getattr(r, name)) for name in ALL} for r in (recording, other)]
    signals = {name: np.concatenate([run[name] for run in runs], axis=1) for name in ALL}
    return replace(recording, run_in=0, lines={}, **signals)


def stepped(recording: Recording) -> Recording:
    """A control that the recorder stores in few steps."""
    step = 0.64 * float(np.std(recording.u))
    return replace(recording, u=step * np.round(recording.u / step))


def other_pilot(recording: Recording) -> Recording:
    """The control and nothing else of another run."""
    other = simulate(
        SCENARIOS["nominal"], np.random.default_rng([5, int(1e9 * recording.u[0, 9] ** 2)])
    )
    return replace(recording, u=other.u)


def deaf(recording: Recording) -> Recording:
    """A control that holds remnant alone."""
    rng = np.random.default_rng(int(1e9 * recording.u[0, 9] ** 2))
    noise = rng.standard_normal((1, recording.u.shape[1] + 24))
    smooth = np.lib.stride_tricks.sliding_window_view(noise, 25, axis=1).mean(axis=2)
    return replace(recording, u=smooth)


def without(recording: Recording, *names: str) -> Recording:
    """The recording as a laboratory has it that did not record some forcing functions."""
    return replace(recording, lines={}, **dict.fromkeys(names))


#: What may be wrong with the signals, the code of the remark, and the signal or run it must name.
PLANTED: dict[str, tuple[Callable[[Recording], Recording], str, str]] = {
    "two seconds repeated": (repeated, "lost-samples", "x"),
    "20 s of u lost": (lambda r: dropped(r, ("u",)), "lost-samples", ""),
    "20 s of all signals lost": (lambda r: dropped(r, ALL), "lost-samples", ""),
    "a missing-value code": (spoilt, "lost-samples", "u"),
    "u clipped": (clipped, "rounded", "u"),
    "u drifts": (lambda r: replace(r, u=r.u + 0.01 * r.time), "drift", "u"),
    "u late by 1 s": (lambda r: delayed(r, 1.0), "late-signal", "u"),
    "sign of e": (lambda r: replace(r, e=-r.e), "wrong-sign", "e"),
    "sign of x": (lambda r: replace(r, x=-r.x), "wrong-sign", "x"),
    "e and x exchanged": (lambda r: replace(r, e=r.x, x=r.e), "exchanged", ""),
    "x in radians": (lambda r: replace(r, x=np.deg2rad(r.x)), "wrong-unit", "x=57.2958"),
    "x in radians, no target": (
        lambda r: replace(without(r, "ft"), x=np.deg2rad(r.x)),
        "wrong-unit",
        "x",
    ),
    "e in millimetres": (lambda r: replace(r, e=1000.0 * r.e), "wrong-unit", "e"),
    "sign of e, no target": (lambda r: replace(without(r, "ft"), e=-r.e), "wrong-sign", "e"),
    "sign of u": (lambda r: replace(r, u=-r.u), "wrong-sign", "u"),
    "sign of u, no target": (lambda r: replace(without(r, "ft"), u=-r.u), "wrong-sign", "u"),
    "sign of fd": (lambda r: replace(r, fd=-r.fd), "wrong-sign", "fd"),
    "signs of u and fd": (lambda r: replace(r, u=-r.u, fd=-r.fd), "wrong-sign", "u and fd"),
    "u of another run": (other_pilot, "output-unrelated", "x"),
    "x and e tripled in one run": (
        lambda r: in_one_run(r, lambda r: replace(r, e=3.0 * r.e, x=3.0 * r.x, ft=3.0 * r.ft)),
        "element-differs",
        "run 3",
    ),
    "two runs appended": (appended, "lost-samples", "x"),
    "fd ten times as large": (lambda r: replace(r, fd=10.0 * r.fd), "wrong-unit", "fd=0.1"),
    "u without the forcing": (deaf, "output-unrelated", "x"),
    "e is zero": (lambda r: replace(r, e=0.0 * r.e), "motionless", "e"),
    "x is zero": (lambda r: replace(r, x=0.0 * r.x), "motionless", "x"),
}


def named(recording: Recording, code: str, where: str) -> bool:
    """Whether a remark on the recording has the code, and names the signal or run."""
    return any(r.code == code and re.search(rf"\b{where}\b", r) for r in remarks(recording))


def named_by_a_fit(recording: Recording) -> bool:
    """Whether `mle` says that it explains nothing, or fails."""
    model = SCENARIOS["nominal"].model
    estimate = identify(method_named("mle"), recording, model, np.random.default_rng(1))
    told = "little-explained" in codes_of(estimate.remarks)
    return told or not estimate.outcome.usable


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
    "gain": (
        lambda r: replace(r, fd=-r.fd / 3.49, origin={**r.origin, "fd": "d"}),
        "use --map fd=-3.49*d",
    ),
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
    assert what not in ("late", "early") or chosen_element(recording).origin != "identified"


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


def test_a_control_that_comes_far_too_late_is_named_by_the_fit() -> None:
    for seed in range(2):
        assert named_by_a_fit(delayed(recording_of("nominal", seed), 10.0))
    assert not named_by_a_fit(recording_of("nominal", 0))


@pytest.mark.parametrize("name", SOUND)
def test_sound_recordings_have_no_remarks(name: str) -> None:
    for seed in range(500, 500 + RECORDINGS):
        recording = recording_of(name, seed)
        assert remarks(recording) == findings(recording) == ()
        assert band_end(recording) == np.inf


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
    # Here x goes on as if it had not been, which is all that may be said.
    assert [r.code for r in remarks(replace(recording, u=u))] == ["output-unrelated"]


def test_the_first_thing_that_is_wrong_is_told_and_how_to_mend_it() -> None:
    recording = recording_of("nominal", 2)
    (remark,) = remarks(replace(recording, e=-recording.e))
    assert (remark.code, remark.grade) == ("wrong-sign", "wrong")
    assert remark.endswith("flip it with --map e=-e")
    assert remarks(replace(recording, e=recording.e + 1.0)) == ()  # methods take offsets out
    assert "ft is 2 times what the others" in remarks(replace(recording, ft=2.0 * recording.ft))[0]
    bent = recording.ft + 0.3 * np.abs(recording.ft)
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
    assert remarks(replace(known, e=known.e + 0.1 * np.std(known.e))) == remarks(known)
