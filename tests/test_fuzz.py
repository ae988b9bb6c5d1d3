"""Any bytes give a recording or one printable sentence; `nox -s fuzz` tries many more."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from matlab_files import save_v73
from scipy.io import savemat

from pilotid.recording.files import load_recording, save_recording
from pilotid.recording.recording import Recording
from pilotid.support.types import InputError

SAMPLES = 120
DT = 0.1

#: How many files of each kind are tried: those of every day are always the same.
COUNT = int(os.environ.get("PILOTID_FUZZ", "150"))

few = settings(
    max_examples=COUNT,
    derandomize=COUNT == 150,
    deadline=None,
    database=None,
    # The files of one example are overwritten by the next.
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def variables() -> dict[str, Any]:
    e, u, x = np.random.default_rng(2).standard_normal((3, SAMPLES, 2))
    return {"t": np.arange(SAMPLES)[:, np.newaxis] * DT, "e": e, "u": u, "x": x}


def csv_lines() -> list[str]:
    rows = np.hstack([np.atleast_2d(value) for value in variables().values()])
    body = [",".join(f"{v:.5g}" for v in row) for row in rows.tolist()]
    return ["t,e_1,e_2,u_1,u_2,x_1,x_2", *body]


def mat_bytes(compressed: bool) -> bytes:
    stream = io.BytesIO()
    savemat(stream, variables(), do_compression=compressed)
    return stream.getvalue()


def load(path: Path) -> Recording | None:
    """The recording in a file, or None if it is refused in one printable sentence."""
    try:
        recording = load_recording(path)
    except InputError as error:
        message = str(error)
        assert message.isprintable()
        assert path.stem in message
        assert len(message) < 600
        return None
    for name in ("e", "u", "x"):
        assert np.isfinite(getattr(recording, name)).all()
    return recording


def assert_can_be_saved(recording: Recording, folder: Path) -> None:
    """What was read is written and read again to the bit."""
    for name in ("saved.csv", "saved.mat"):
        save_recording(recording, folder / name)
        again = load_recording(folder / name)
        assert again.u.tobytes() == recording.u.tobytes()
        assert (again.dt, again.run_in) == (recording.dt, recording.run_in)
        assert (again.units, again.lines) == (recording.units, recording.lines)


@few
@given(content=st.binary(max_size=2000), suffix=st.sampled_from([".csv", ".mat"]))
def test_any_bytes(tmp_path: Path, content: bytes, suffix: str) -> None:
    path = tmp_path / f"any{suffix}"
    path.write_bytes(content)
    assert load(path) is None


cells = st.one_of(
    st.floats().map(repr),
    st.sampled_from(["", " ", "nan", '"', '"\n"', "1e-310", "1e160", "\0", "1,5", "\x1b[31m", "x"]),
    st.text(max_size=5),
)


@few
@given(
    changes=st.lists(
        st.tuples(st.integers(0, SAMPLES), st.integers(0, 6), cells), min_size=1, max_size=4
    ),
    separator=st.sampled_from([",", ";"]),
)
def test_changed_cells_of_csv(
    tmp_path: Path, changes: list[tuple[int, int, str]], separator: str
) -> None:
    table = [line.split(",") for line in csv_lines()]
    for row, column, cell in changes:
        table[row][column] = cell
    path = tmp_path / "changed.csv"
    text = "\n".join(separator.join(row) for row in table)
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    recording = load(path)
    if recording is not None:
        assert recording.runs <= 2
        assert_can_be_saved(recording, tmp_path)


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["u", "x", "ft", "fd", "y"]), inner, max_size=3)
    ),
    max_leaves=6,
)
keys = st.sampled_from(["runs", "run_in", "dt", "units", "lines", "controlled_element", "other"])
lines = st.dictionaries(st.sampled_from(["ft", "fd"]), st.lists(st.integers(1, 99), max_size=4))
units = st.dictionaries(st.sampled_from(["e", "u", "x"]), st.text(max_size=4))


@few
@given(
    notes=st.one_of(
        st.dictionaries(keys, values, max_size=4),
        st.fixed_dictionaries({}, optional={"lines": lines, "units": units}),
        values,
    )
)
def test_any_sidecar(tmp_path: Path, notes: object) -> None:
    path = tmp_path / "with_notes.csv"
    path.write_text("\n".join(csv_lines()))
    path.with_suffix(".json").write_text(json.dumps(notes))
    recording = load(path)
    if recording is not None:
        assert_can_be_saved(recording, tmp_path)


@pytest.mark.parametrize(
    "kind", ["compressed", *(pytest.param(k, marks=pytest.mark.long) for k in ("plain", "v73"))]
)
@few
@given(
    changes=st.lists(
        st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=4
    ),
    near=st.booleans(),
)
def test_changed_bytes_of_mat_files(
    tmp_path: Path, kind: str, changes: list[tuple[float, int]], near: bool
) -> None:
    if kind == "v73":
        content = bytearray(save_v73(tmp_path / "good.mat", variables()).read_bytes())
    else:
        content = bytearray(mat_bytes(kind == "compressed"))
    first = 512 if kind == "v73" else 128
    last = min(len(content), first + 1000) if near else len(content)
    for place, byte in changes:
        content[first + int(place * (last - first))] = byte
    path = tmp_path / "changed.mat"
    path.write_bytes(content)
    recording = load(path)
    if recording is not None:
        assert recording.runs == 2
        differing = np.count_nonzero(recording.u != variables()["u"].T)
        assert differing <= len(changes) or kind == "v73"
