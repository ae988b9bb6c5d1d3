"""Recordings of human pilots: the command line gives numbers of the published size.

They run where PILOTID_MEASURED names the folder of the recordings.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from checks.published import LED, LOW, following_runs, inverse_shares, preview_runs
from helpers import Run, strict
from scipy.io import loadmat

from pilotid import MODELS, identify, load_recording
from pilotid.checks.checks import remarks
from pilotid.likelihood.choice import by_likelihood
from pilotid.methods.fourier import Fourier

FOLLOWING = MODELS["following"]

pytestmark = pytest.mark.numerical


def fitted(run: Run, *arguments: object) -> Any:
    """The result of `pilotid fit` as it prints it."""
    answer = run("fit", *arguments, "--json", "-")
    assert answer.status == 0, answer.err
    return strict(answer.out)


@pytest.mark.parametrize(("condition", "model"), [("C3", "single"), ("C6", "multi")])
def test_yaw(run: Run, measured: Path, condition: str, model: str) -> None:
    file = measured / "yaw" / f"ae2224I_measurement_data_subj3_{condition}.mat"
    result = fitted(run, file, "--model", model, "--method", "mle-white")
    assert result["recording"]["runs"] == 5
    (estimate,) = result["estimates"]
    assert estimate["outcome"] == "converged"
    values = {key: entry["value"] for key, entry in estimate["parameters"].items()}
    assert 0.15 < values["tdvis"] < 0.40
    assert 8.0 < values["fnm"] < 15.0
    assert 60.0 < estimate["vaf"] < 95.0


def test_motion_in_position_control_is_a_rate_beside_lead_and_lag(measured: Path) -> None:
    file = measured / "yaw" / "ae2224I_measurement_data_subj4_C4.mat"
    recording = load_recording(file)
    names = ("single", "lead-lag", "rate", "lead-lag-motion")
    found = by_likelihood(recording, [MODELS[name] for name in names], 1)
    bic = {held.model: held.bic for held in found}
    # 10 is very strong evidence on the scale of Kass and Raftery (1995).
    assert bic["lead-lag-motion"] < bic["lead-lag"] - 10.0
    assert bic["lead-lag"] < bic["single"] - 10.0
    assert bic["lead-lag-motion"] < bic["rate"] - 10.0


def test_responses_at_the_lines_are_the_laboratory_s_within_their_errors(measured: Path) -> None:
    """Its own coefficients, of which those at 13.1 rad/s lie far from the other forcing's lines."""
    off, alone = [], []
    for file in sorted(measured.glob("yaw/*_C[456].mat")):
        of_lab = loadmat(file)
        found = Fourier().first_step(load_recording(file), MODELS["rate"])
        theirs = np.array([of_lab["Hpe_FC"].ravel(), of_lab["Hpxd_FC"].ravel() * 1j * found.omega])
        np.testing.assert_allclose(found.omega, of_lab["w_FC"].ravel(), rtol=1e-2)
        off.append(np.abs(found.value - theirs) / found.std)
        alone.append(off[-1][0, np.argmin(np.abs(found.omega - 13.1))])
    assert np.size(off) == 480
    assert np.max(off) < 3.0
    assert np.sqrt(np.mean(np.square(alone))) < 1.8


def test_rollpitch(run: Run, measured: Path) -> None:
    files = sorted(measured.glob("rollpitch/pilot2_C2_run*_pitch.csv"))
    assert len(files) == 6
    single = fitted(run, files[0], "--method", "mle-white")
    assert single["estimates"][0]["outcome"] == "converged"
    assert single["estimates"][0]["vaf"] > 50.0
    joint = fitted(run, *files, "--joint", "--method", "mle-white")
    assert joint["recording"]["runs"] == 6
    assert 0.15 < joint["estimates"][0]["parameters"]["tdvis"]["value"] < 0.40


PREVIEW_MAP = "t=time,ft=ref,u=inp,fd=dis,x=state"
FOLLOWING_MAP = "ft=target,u=response,x=response"
SIGMAS, STRUCTS = (11, 13, 17, 21, 25, 29), ("identification", "validation")


def briefly(run: Run, *arguments: object) -> list[str]:
    """The lines of `pilotid check --brief`, without the summary."""
    answer = run("check", "--brief", *arguments)
    assert answer.status == 0, answer.err
    return [line for line in answer.out.splitlines() if " x " in line]


def test_recordings_with_a_ramp_are_cut_to_their_periods(run: Run, measured: Path) -> None:
    files = sorted(measured.glob("preview/*.csv"))
    told = briefly(run, *files, "--map", PREVIEW_MAP)
    assert [": 1 x 40 s, e u x ft fd, " in line for line in told] == [True] * 36
    assert [line.rpartition("; ")[2] for line in told] == ["note: preprocessed"] * 36
    # One was saved by numpy as well, its forcing functions as objects that may not be read.
    (same,) = measured.glob("preview/*.npz")
    mapping = {"t": "time_", "u": "inp_", "x": "out_", "e": "-out_"}
    archive = load_recording(same, mapping)
    names = dict(pair.split("=") for pair in PREVIEW_MAP.split(","))
    text = load_recording(same.with_suffix(".csv"), names)
    assert archive.u[0].tolist()[: text.u.shape[1]] == text.u[0].tolist()


def test_trials_are_read_by_level_and_structs_by_name(run: Run, measured: Path) -> None:
    told = briefly(
        run,
        *(measured / "following" / f"data.mat::sigma={sigma}" for sigma in SIGMAS),
        *("--map", FOLLOWING_MAP, "--dt", 1 / 60),
    )
    assert [line.partition("::sigma=")[2][:9] for line in told] == [f"{s}: 20 x " for s in SIGMAS]
    parts = (measured / "course" / f"ae4320_dataset.mat::{name}" for name in STRUCTS)
    told = briefly(run, *parts, "--map", "fd=-3.49*fd")
    assert ["identification: 1 x 81.92 s" in told[0], "validation: 1 x" in told[1]] == [True, True]


def test_feedforward_and_feedback_of_exchanged_lines(measured: Path) -> None:
    recording = preview_runs(measured / "preview", "zu", "fo")
    assert recording.runs == 12
    assert not remarks(recording)
    found = Fourier().first_step(recording, MODELS["pursuit"])
    share, error = inverse_shares(found, "fo")
    low = found.omega <= 2.0 * np.pi * LOW
    weights = error[~low] ** -2
    # Yamagami et al. (2019): above .15 Hz between half of the element's inverse and all of it.
    assert 0.5 < np.sum(weights * share[~low].real) / np.sum(weights) < 0.9
    fit = identify("fourier", recording, LED)
    ends = dict(zip(fit.model.keys, fit.intervals, strict=True))
    assert ends["tdvis"][0] < 0.3
    assert ends["tdvis"][1] > 0.2
    assert ends["tlook"][0] > 0.1
    assert fit.vaf > 50.0


@pytest.mark.long
def test_a_blurred_target_is_followed_late(measured: Path) -> None:
    runs = following_runs(measured / "following" / "data.mat")
    assert [own.runs for own in runs.values()] == [20] * 6
    lag = FOLLOWING.keys.index("tlagt")
    sharp, blurred = (identify("mle", runs[width], FOLLOWING).values[lag] for width in (11, 29))
    assert sharp < 0.08  # Bonnen et al. (2015): .05 to .6 s
    assert blurred > 0.3
