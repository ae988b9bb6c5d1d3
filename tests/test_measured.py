"""Recordings of human pilots: the command line gives numbers of the published size.

They run where PILOTID_MEASURED names the folder of the recordings.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from pilotid.cli.main import main

FOLDER = os.environ.get("PILOTID_MEASURED", "")

pytestmark = pytest.mark.skipif(not FOLDER, reason="PILOTID_MEASURED names no folder of recordings")


def fitted(capfd: pytest.CaptureFixture[str], *arguments: str) -> Any:
    """The result of `pilotid fit` as it prints it."""
    with pytest.raises(SystemExit) as end:
        main(["fit", *arguments, "--json", "-"])
    captured = capfd.readouterr()
    assert not end.value.code, captured.err
    return json.loads(captured.out)


@pytest.mark.parametrize(("condition", "model"), [("C3", "single"), ("C6", "multi")])
def test_yaw(capfd: pytest.CaptureFixture[str], condition: str, model: str) -> None:
    file = Path(FOLDER) / "yaw" / f"ae2224I_measurement_data_subj3_{condition}.mat"
    result = fitted(capfd, str(file), "--model", model, "--method", "mle-white")
    assert result["recording"]["runs"] == 5
    (estimate,) = result["estimates"]
    assert estimate["outcome"] == "converged"
    values = {key: entry["value"] for key, entry in estimate["parameters"].items()}
    assert 0.15 < values["tdvis"] < 0.40
    assert 8.0 < values["fnm"] < 15.0
    assert 60.0 < estimate["vaf"] < 95.0


def test_rollpitch(capfd: pytest.CaptureFixture[str]) -> None:
    folder = Path(FOLDER) / "rollpitch"
    files = sorted(str(path) for path in folder.glob("pilot2_C2_run*_pitch.csv"))
    assert len(files) == 6
    single = fitted(capfd, files[0], "--method", "mle-white")
    assert single["estimates"][0]["outcome"] == "converged"
    assert single["estimates"][0]["vaf"] > 50.0
    joint = fitted(capfd, *files, "--joint", "--method", "mle-white")
    assert joint["recording"]["runs"] == 6
    assert 0.15 < joint["estimates"][0]["parameters"]["tdvis"]["value"] < 0.40
