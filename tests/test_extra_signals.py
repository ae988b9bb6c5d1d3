"""Pilots who act on a signal beside e, x and ft, simulated here and not by pilotid."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from helpers import Run

from pilotid import Channel, PilotModel, Recording, identify
from pilotid.checks.checks import remarks
from pilotid.datasets.signals import PERIOD, paper_disturbance, paper_target
from pilotid.estimate.warnings import unrecorded
from pilotid.model.factors import Delay, Gain, Lead, Neuromuscular
from pilotid.recording.files import load_recording, save_recording
from pilotid.recording.recording import joined
from pilotid.recording.windows import of_runs
from pilotid.support.types import InputError

Kind = Literal["state", "cue"]
DT, WINDOW, RUN_IN = 0.02, 4096, 400
MODEL = PilotModel(
    "two-signals",
    (
        Channel("visual", "error", 1, (Gain("Kvis"), Lead("tlead"), Delay(), Neuromuscular())),
        Channel("cue", on="x2", sign=-1, factors=(Gain("Kcue"), Delay("tcue"), Neuromuscular())),
    ),
)
TRUTH = {
    "state": np.array([0.2, 2.0, 0.3, 0.25, 0.2, 12.0, 0.3]),
    "cue": np.array([0.2, 2.0, 0.3, 0.05, 0.2, 12.0, 0.3]),
}


def simulated(kind: Kind, remnant: float = 0.0, seed: int = 1) -> Recording:
    """A closed loop solved at all frequencies of four periods, of which the last is recorded.

    The pilot sees, beside the error, the rate of the output behind a filter (``state``), or
    sines that have nothing to do with the loop (``cue``).
    """
    rng, count = np.random.default_rng(seed), 4 * WINDOW
    gain, lead, delay, own_gain, own_delay, f, d = TRUTH[kind]
    time = DT * np.arange(count)
    s = 2j * np.pi * np.fft.rfftfreq(count, DT)
    s[0] = 1e-3j
    limb = f**2 / (s * s + 2 * d * f * s + f**2)
    visual = gain * (1 + lead * s) * np.exp(-delay * s) * limb
    other = -own_gain * np.exp(-own_delay * s) * limb
    seen = s / (1 + 0.15 * s) if kind == "state" else 0.0 * s
    plant = 4.0 / s**2
    lines = np.array([7, 12, 16, 23, 37, 53, 71, 97, 127, 157]) if kind == "cue" else np.zeros(0)
    phases = rng.uniform(0.0, 2 * np.pi, lines.size)
    cue = 0.3 * np.sin(2 * np.pi / PERIOD * np.outer(time, lines) + phases).sum(axis=1)
    ft, fd = paper_target().at(time), paper_disturbance().at(time)
    sources = np.fft.rfft([ft, fd, cue, rng.standard_normal(count)])
    sources[:, 0] = 0.0
    noise = remnant / np.sqrt(DT) / (1 + 0.3 * s) / (1 + s / 60) * sources[3]
    closing = visual - other * seen
    driven = visual * sources[0] + other * sources[2] + noise - closing * plant * sources[1]
    u = driven / (1 + plant * closing)
    x = plant * (u + sources[1])
    last = slice(-WINDOW - RUN_IN, None)
    e, u, x, x2 = np.fft.irfft([sources[0] - x, u, x, seen * x + sources[2]], count)[:, None, last]
    own = {"ft": ft[None, last], "fd": fd[None, last], "run_in": RUN_IN}
    return Recording(dt=DT, e=e, u=u, x=x, **own, extra={"x2": x2})


@pytest.mark.numerical
@pytest.mark.parametrize("kind", ["state", "cue"])
def test_parameters_are_exact_without_remnant(kind: Kind) -> None:
    recording = simulated(kind)
    for method in ("mle", *(["fourier"] if kind == "state" else [])):
        estimate = identify(method, recording, MODEL)
        np.testing.assert_allclose(estimate.values, TRUTH[kind], rtol=1e-6, err_msg=method)
    np.testing.assert_allclose(identify("arx", recording, MODEL).values, TRUTH[kind], rtol=1e-3)


@pytest.mark.numerical
@pytest.mark.parametrize(
    ("kind", "method"),
    [(kind, method) for kind in ("state", "cue") for method in ("mle", "bayes", "arx")]
    + [("state", "fourier")],
)
def test_errors_are_as_large_as_claimed_with_a_remnant(kind: Kind, method: str) -> None:
    estimate = identify(method, simulated(kind, 0.02), MODEL)
    errors = (estimate.values - TRUTH[kind]) / estimate.std_error
    assert np.abs(errors).max() < 4.0
    assert np.all(estimate.std_error < 0.9 * TRUTH[kind])


def test_lines_do_not_tell_a_signal_that_does_not_follow_them() -> None:
    estimate = identify("fourier", simulated("cue", 0.02), MODEL)
    assert "x2 does not follow the forcing functions" in estimate.message


def test_an_extra_signal_is_treated_like_all_others() -> None:
    recording = simulated("state", 0.02)
    cut = recording.cut(10.0, 60.0)
    assert np.array_equal(cut.window(cut.extra["x2"]), recording.extra["x2"][:, 900:3400])
    other = simulated("state", 0.02, seed=2)
    both = joined([recording, other])
    assert np.array_equal(of_runs(both, [2], "run 2").extra["x2"], other.extra["x2"])
    with pytest.raises(InputError, match="set of signals"):
        joined([recording, Recording(dt=DT, e=other.e, u=other.u, x=other.x, run_in=RUN_IN)])
    spiky = recording.extra["x2"].copy()
    spiky[0, 2000] = 1e3
    told = remarks(recording.with_arrays({"x2": spiky}))
    assert any(remark.code == "lost-samples" and remark.startswith("x2 is") for remark in told)


@pytest.mark.parametrize("suffix", [".csv", ".mat"])
@pytest.mark.parametrize("runs", [1, 2])
def test_extra_signals_are_restored_to_the_bit(tmp_path: Path, suffix: str, runs: int) -> None:
    recording = joined([simulated("cue", 0.02, seed) for seed in range(runs)])
    recording = Recording(**{**vars(recording), "units": {"x2": "m/s"}})
    save_recording(recording, tmp_path / f"R{suffix}")
    back = load_recording(tmp_path / f"R{suffix}")
    assert back.extra["x2"].tobytes() == recording.extra["x2"].tobytes()
    assert back.units["x2"] == "m/s"


def test_a_mapping_names_columns_of_extra_signals(run: Run, tmp_path: Path) -> None:
    recording = simulated("state", 0.02)
    columns = np.column_stack([recording.time, *(s[0] for s in recording.arrays.values())])
    file = tmp_path / "R.csv"
    np.savetxt(file, columns, delimiter=",", header="t,e,u,x,ft,fd,state", comments="", fmt="%.9g")
    names = [name for name in recording.arrays if name != "x2"]
    np.savez(tmp_path / "R.npz", t=recording.time, state=recording.extra["x2"][0],
             **{name: recording.arrays[name][0] for name in names})  # fmt: skip
    for path in (file, tmp_path / "R.npz"):
        read = load_recording(path, {"x2": "-2*state"})
        np.testing.assert_allclose(read.extra["x2"], -2 * recording.extra["x2"], atol=1e-8)
    assert load_recording(file).signals == names
    printed = run("check", file, "--map", "x2=state")
    assert "x2       extra signal                   state" in printed.out, printed.err


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        ("x_2=state", "an extra signal cannot be named 'x_2'"),
        ("Run=state", "an extra signal cannot be named 'Run'"),
        ("x2=nothing", "no 'nothing' for x2 (extra signal)"),
    ],
)
def test_bad_names_cost_a_sentence(run: Run, tmp_path: Path, mapping: str, words: str) -> None:
    save_recording(simulated("state"), tmp_path / "R.csv")
    printed = run("check", tmp_path / "R.csv", "--map", mapping)
    assert printed.status == 2
    assert words in printed.err


def test_a_model_of_a_signal_that_is_not_recorded_is_refused() -> None:
    recording = simulated("state")
    bare = Recording(dt=DT, e=recording.e, u=recording.u, x=recording.x, run_in=RUN_IN)
    assert "acts on what is not recorded (x2)" in str(unrecorded(bare, MODEL))
    assert "acts on what is not recorded (x2)" in identify("mle", bare, MODEL).message
    with pytest.raises(ValueError, match="cannot act on 'u'"):
        Channel("own", "u", 1, (Gain("K"),))
