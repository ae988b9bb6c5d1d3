"""Runs and spans of recordings, and recordings that are excluded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import NOMINAL, Run

from pilotid.datasets import simulate
from pilotid.experiment.files import Part, excluded_of, parts_of
from pilotid.recording.files import Reading, save_recording
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import NotMultisineError, forcing_lines
from pilotid.recording.windows import chosen_runs, span_of
from pilotid.support.numbers import recording_rng
from pilotid.support.types import InputError

RECORDING: Recording = simulate(replace(NOMINAL, runs=4), recording_rng(1, "four runs"))


@pytest.mark.parametrize(
    ("text", "runs"), [("2-4", [1, 2, 3]), ("1,3", [0, 2]), ("4", [3]), ("1-2,2", [0, 1])]
)
def test_runs(text: str, runs: list[int]) -> None:
    found = chosen_runs(RECORDING, text)
    assert found.u.tolist() == RECORDING.u[runs].tolist()
    assert found.runs == len(runs)


def test_a_span_keeps_what_was_before_as_run_in() -> None:
    found = RECORDING.cut(20.0, 61.0)
    assert found.duration == pytest.approx(41.0)
    assert found.run_in == RECORDING.run_in + 1000
    start = RECORDING.run_in + 1000
    np.testing.assert_array_equal(found.window(found.u), RECORDING.u[:, start : start + 2050])
    with pytest.raises(NotMultisineError):  # no whole periods
        forcing_lines(found)


def test_lines_stay_where_the_span_holds_whole_periods() -> None:
    even = replace(RECORDING, lines={"ft": (6, 10), "fd": (5, 8)})
    assert even.cut(0.0, 40.96).lines == {"ft": (3, 5)}


@pytest.mark.parametrize("text", ["", "5", "5:5", "9:3", "-1:20", "a:b", "0:inf", "1:2:3", "nan:4"])
def test_spans_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="--span"):
        span_of(text)


def test_runs_are_counted_over_files_that_are_one_recording(tmp_path: Path) -> None:
    files = [tmp_path / f"run{run}.csv" for run in range(3)]
    for run, file in enumerate(files, start=1):
        save_recording(chosen_runs(RECORDING, str(run)), file)
    (found,), _ = Reading(runs="2-3", span="0:41").all(files, joint=True)
    assert (found.runs, found.duration) == (2, pytest.approx(41.0))
    np.testing.assert_allclose(found.u[0, :100], RECORDING.u[1, :100])


@pytest.mark.parametrize("command", ["fit", "check"])
@pytest.mark.parametrize("option", [("--runs", "9"), ("--span", "3:1")])
def test_commands_refuse_what_is_not_there(
    run: Run, tmp_path: Path, command: str, option: tuple[str, str]
) -> None:
    save_recording(RECORDING, tmp_path / "r.csv")
    answer = run(command, tmp_path / "r.csv", *option)
    assert answer.status == 2
    assert option[0] in answer.err


def parts() -> list[Part]:
    files = [Path(f"s{s}_{c}.csv") for s in (1, 2) for c in ("A", "B")]
    return parts_of(files, "s{subject}_{condition}")[0]


def test_recordings_are_excluded() -> None:
    left, out = excluded_of(parts(), ["subject=2,condition=B"])
    assert [part.name for part in left] == ["s1_A.csv", "s1_B.csv", "s2_A.csv"]
    assert [own.name for own in out] == ["s2_B.csv"]
    left, out = excluded_of(parts(), ["subject=2"])
    assert (len(left), len(out)) == (2, 2)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("subject=9", "subject=1, subject=2"),
        ("subject", "FIELD=VALUE"),
        ("axis=roll", "FIELD=VALUE"),
        ("", "FIELD=VALUE"),
    ],
)
def test_who_is_not_there_cannot_be_excluded(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        excluded_of(parts(), [text])
    with pytest.raises(InputError, match="all that is left"):
        excluded_of(parts(), ["subject=1", "subject=2"])
