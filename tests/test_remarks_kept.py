"""What a study keeps of remarks, and what its report says of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from helpers import NOMINAL, recording_of
from test_output import estimate

from pilotid.checks.checks import remarks
from pilotid.study.run import LONGEST_TOLD, told
from pilotid.study.study import Study
from pilotid.study.table import Store


def test_a_study_keeps_what_a_user_is_told() -> None:
    sound = recording_of(NOMINAL)
    assert told(remarks(sound), estimate()) == ""
    drifting = replace(sound, u=sound.u + 0.01 * sound.time)
    line = told(remarks(drifting), estimate(remarks=("mind the gap", "and the step")))
    assert line.startswith("recording: u drifts by")
    assert "take it out with --detrend | " in line
    assert line.endswith(" | mind the gap | and the step") or line.endswith(" ...")
    assert len(told(remarks(sound), estimate(remarks=("long " * 100,)))) == LONGEST_TOLD


@pytest.mark.numerical
def test_remarks_of_a_study_are_in_its_store(tmp_path: Path) -> None:
    Study(["nominal", "recorder-lost"], "mle", 1).run_in(tmp_path, workers=1)
    with Store(tmp_path) as store:
        kept = {fit.scenario: fit.remarks for fit in store.fits()}
    assert not kept["nominal"]
    assert "samples are lost or spiked" in kept["recorder-lost"]
