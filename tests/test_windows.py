"""Windows of whole periods, other sampling rates, and signals of several rates in one file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pilotid.checks.checks import remarks
from pilotid.recording.files import Reading, load_recording, save_recording
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import forcing_lines
from pilotid.recording.windows import whole_periods
from pilotid.support.remarks import codes_of
from pilotid.support.types import FloatArray, InputError

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


def stepping(samples: int) -> FloatArray:
    return np.sign(sines((1,), samples))


LEFT_ALONE = {
    "one whole period": ramped(0, PERIOD),
    "no forcing function": Recording(DT, *np.random.default_rng(1).standard_normal((3, 1, 2700))),
    "noise": recorded(np.random.default_rng(2).standard_normal(2700)),
    "steps": recorded(stepping(2700)),
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
