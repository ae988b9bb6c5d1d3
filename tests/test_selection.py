"""Runs, spans and whole periods of recordings, and recordings that are excluded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import NOMINAL, Run

from pilotid.checks.checks import remarks
from pilotid.datasets import simulate
from pilotid.experiment.files import Part, parts_of, without
from pilotid.recording.files import Reading, load_recording, save_recording
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import NotMultisineError, forcing_lines
from pilotid.recording.windows import chosen_runs, span_of, whole_periods
from pilotid.support.numbers import recording_rng
from pilotid.support.remarks import codes_of
from pilotid.support.types import FloatArray, InputError

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
    (found,) = Reading(runs="2-3", span="0:41").all(files, joint=True)[0].values()
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
    left = without(parts(), ["subject=2,condition=B"])
    assert [part.name for part in left] == ["s1_A.csv", "s1_B.csv", "s2_A.csv"]
    assert [part.name for part in without(parts(), ["subject=2"])] == ["s1_A.csv", "s1_B.csv"]


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
        without(parts(), [text])
    with pytest.raises(InputError, match="all that is left"):
        without(parts(), ["subject=1", "subject=2"])


# ---------------------------------------------------------------------- whole periods

DT = 1.0 / 60.0
PERIOD = 1200  # samples
LINES = {"ft": (2, 5, 11), "fd": (3, 7, 13)}


def sines(lines: tuple[int, ...], samples: int, period: float = PERIOD) -> FloatArray:
    t = np.arange(samples) / period
    return np.asarray(sum(np.sin(2 * np.pi * k * t + k) / k for k in lines))


def recorded(ft: FloatArray, fd: FloatArray | None = None, **more: Any) -> Recording:
    x = np.random.default_rng(3).standard_normal((1, ft.size))
    forcing = {"ft": ft[None], **({} if fd is None else {"fd": fd[None]})}
    return Recording(DT, e=ft - x, u=2.0 * x, x=x, **forcing, **more)


def ramped(ramp: int, samples: int, **lines: tuple[int, ...]) -> Recording:
    """Forcing functions that fade in over so many samples."""
    fade = np.minimum(1.0, np.arange(samples) / max(1, ramp)) ** 2
    own = {name: fade * sines(k, samples) for name, k in (lines or LINES).items()}
    return recorded(**own)


@pytest.mark.parametrize(
    ("ramp", "samples", "start", "periods"),
    [
        (300, 2702, 300, 2),  # as recorded by Yamagami et al. 2019: what is left over is dropped
        (0, 2650, 240, 2),  # down to a whole second
        (0, 1400, 180, 1),
        (300, 1900, 660, 1),
    ],
)
def test_windows_are_cut_to_whole_periods(
    ramp: int, samples: int, start: int, periods: int
) -> None:
    whole = ramped(ramp, samples)
    cut = whole_periods(whole)
    assert (cut.run_in, cut.samples) == (start, periods * PERIOD)
    assert codes_of(remarks(cut))[0] == "preprocessed"
    assert cut.source == whole.source
    for name, lines in forcing_lines(cut).items():
        assert lines.tolist() == [periods * line for line in LINES[name]]


LEFT_ALONE = {
    "one whole period": ramped(0, PERIOD),
    "no forcing function": Recording(DT, *np.random.default_rng(1).standard_normal((3, 1, 2700))),
    "noise": recorded(np.random.default_rng(2).standard_normal(2700)),
    "steps": recorded(np.sign(sines((1,), 2700))),
    "few lines": ramped(300, 2700, ft=(2, 5)),
    "a repetition that is not exact": recorded(
        sines((2, 5, 11, 17, 23), 2700) + 0.02 * np.random.default_rng(2).standard_normal(2700)
    ),
    "next to no repetition": ramped(0, PERIOD + 60),
}


@pytest.mark.parametrize("name", LEFT_ALONE)
def test_other_windows_are_left_alone(name: str) -> None:
    assert whole_periods(LEFT_ALONE[name]) is LEFT_ALONE[name]


def write_csv(file: Path, recording: Recording) -> Path:
    names = [n for n in ("e", "u", "x", "ft", "fd") if getattr(recording, n) is not None]
    table = np.column_stack([recording.time, *(getattr(recording, n)[0] for n in names)])
    np.savetxt(file, table, delimiter=",", header=",".join(["t", *names]))
    return file


def test_a_span_and_notes_override_whole_periods(tmp_path: Path) -> None:
    file = write_csv(tmp_path / "F.csv", ramped(300, 2702))
    assert Reading().one(file).samples == 2 * PERIOD
    assert Reading(span="0:45").one(file).samples == 2700
    with pytest.raises(InputError, match=r"lasts 9\.5 s"):
        Reading(span="5:14.5", lead_in=1.0).one(file)
    # What pilotid writes says how long its run-in is, and is read as it was.
    save_recording(ramped(300, 2702), tmp_path / "G.csv")
    assert load_recording(tmp_path / "G.csv").samples == 2702
