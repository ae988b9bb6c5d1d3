"""Files that are broken on purpose: one sentence each, soon and in little memory."""

from __future__ import annotations

import contextlib
import json
import os
import re
import socket
import struct
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from matlab_files import save_v73
from scipy.io import loadmat, savemat

from pilotid.recordings.files import load_recording, save_recording
from pilotid.recordings.mat_v5 import MatV5
from pilotid.recordings.recording import Recording
from pilotid.types import FloatArray, InputError

DT = 0.05
SAMPLES = 240  # 12 s
SOON = 5.0  # seconds, many times what is needed


def variables(runs: int = 1) -> dict[str, FloatArray]:
    """The variables of a good recording."""
    rng = np.random.default_rng(8)
    e, u, x = rng.standard_normal((3, SAMPLES, runs))
    return {"t": np.arange(SAMPLES)[:, np.newaxis] * DT, "e": e, "u": u, "x": x}


def recording(**changes: object) -> Recording:
    e, u, x = np.random.default_rng(8).standard_normal((3, 1, SAMPLES))
    fields = {"dt": DT, "e": e, "u": u, "x": x, **changes}
    return Recording(**fields)  # type: ignore[arg-type]


def csv_text(samples: int = SAMPLES) -> str:
    content = np.hstack([variables()[name][:samples] for name in "teux"])
    return "t,e,u,x\n" + "".join(",".join(map(repr, row)) + "\n" for row in content.tolist())


def refused(path: Path | str, *words: str, mapping: dict[str, str] | None = None) -> str:
    """Loading fails soon, with one short printable sentence that holds these words."""
    start = time.perf_counter()
    with pytest.raises(InputError) as caught:
        load_recording(path, mapping)
    assert time.perf_counter() - start < SOON
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 600
    for word in words:
        assert word in message
    return message


# ------------------------------------------------------------------ what is no file


def test_pipe_is_refused_without_waiting_for_a_writer(tmp_path: Path) -> None:
    for name in ("F.csv", "F.mat"):
        os.mkfifo(tmp_path / name)
        refused(tmp_path / name, name, "it is a pipe, not a file")


def test_pipe_as_sidecar(tmp_path: Path) -> None:
    (tmp_path / "F.csv").write_text(csv_text())
    os.mkfifo(tmp_path / "F.json")
    refused(tmp_path / "F.csv", "F.json", "it is a pipe")


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/full", "/dev/null"])
@pytest.mark.parametrize("name", ["F.csv", "F.mat"])
def test_device(tmp_path: Path, device: str, name: str) -> None:
    (tmp_path / name).symlink_to(device)
    refused(tmp_path / name, name, "it is a device, not a file")


def test_folder_and_socket(tmp_path: Path) -> None:
    (tmp_path / "F.csv").mkdir()
    refused(tmp_path / "F.csv", "it is a folder, not a file")
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_UNIX) as sock:
        sock.bind(f"{folder}/F.mat")  # under a short path: sockets take about 100 characters
        refused(f"{folder}/F.mat", "it is a socket, not a file")


def test_link_in_a_circle(tmp_path: Path) -> None:
    (tmp_path / "F.csv").symlink_to(tmp_path / "F.csv")
    refused(tmp_path / "F.csv", "F.csv: cannot be read")


@pytest.mark.parametrize("suffix", [".csv", ".mat"])
def test_names_that_no_file_can_have(suffix: str) -> None:
    refused("a" * 5000 + suffix, "cannot be read", "aaa" + suffix)
    refused("a\0b" + suffix, r"a\x00b" + suffix, "cannot be read")


def test_saving_under_a_name_that_is_too_long(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        save_recording(recording(), tmp_path / ("a" * 5000 + ".mat"))


def test_name_of_255_characters_needs_no_sidecar(tmp_path: Path) -> None:
    path = tmp_path / ("a" * 251 + ".csv")
    path.write_text(csv_text())
    assert load_recording(path).runs == 1


@pytest.mark.parametrize(
    "name", ["\x1b[31mF.csv", "F\n2.csv", "F\u202e2.csv", "F\x7f.csv", "\x9bF.csv"]
)
def test_control_characters_in_names_of_files_are_escaped(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    refused(path, "no such file")
    path.write_text(csv_text())
    escaped = name.encode("unicode_escape").decode()
    assert load_recording(path).source == f"{tmp_path}/{escaped}"
    path.write_text(csv_text(10))
    refused(path, escaped)
    path.with_suffix(".json").write_text("{")
    refused(path, escaped.removesuffix("csv") + "json")


def test_name_that_is_no_unicode(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"F\xe9.csv")
    path.write_text(csv_text())
    assert load_recording(path).source == rf"{tmp_path}/F\udce9.csv"


def test_source_given_in_python_is_made_printable() -> None:
    assert recording(source="a\x1b[2Jb").source == r"a\x1b[2Jb"


# ------------------------------------------------------------------ CSV


def wide(runs: int) -> str:
    """A recording of many runs, of 100 samples."""
    header = ",".join(["t", "e", "x", *(f"u_{i + 1}" for i in range(runs))])
    row = ",".join(["1"] * (runs + 2))
    return header + "\n" + "".join(f"{n / 10},{row}\n" for n in range(5))


def test_forty_thousand_columns(tmp_path: Path) -> None:
    (tmp_path / "F.csv").write_text(wide(40_000))
    refused(tmp_path / "F.csv", "signal e has 1 runs of 5 samples but u has 40000")


def test_row_without_end(tmp_path: Path) -> None:
    with (tmp_path / "F.csv").open("wb") as stream:
        stream.write(b"," * 20_000_000)
    refused(tmp_path / "F.csv", "line 1 is longer than 4194304 characters")
    with (tmp_path / "F.csv").open("wb") as stream:
        stream.write(b"t,e,u,x\n" + b'"\n",' * 3_000_000)
    refused(tmp_path / "F.csv", "is longer than 4194304 characters")


def test_file_too_large_to_read(tmp_path: Path) -> None:
    for name, size in (("F.csv", 2**30 + 1), ("F.mat", 2**32 + 1)):
        with (tmp_path / name).open("wb") as stream:
            stream.truncate(size)
        refused(tmp_path / name, name, "MB large but at most")


def test_more_values_than_a_recording_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pilotid.recordings.csv_table.MOST_VALUES", 4 * 239)
    (tmp_path / "F.csv").write_text(csv_text())
    refused(tmp_path / "F.csv", "more than 956 values")
    (tmp_path / "G.csv").write_text(csv_text(239))
    assert load_recording(tmp_path / "G.csv").samples == 239


def test_a_label_a_row(tmp_path: Path) -> None:
    body = "".join(f"{n},{n},1,1,1\n" for n in range(20_000))
    (tmp_path / "F.csv").write_text("run,t,e,u,x\n" + body)
    refused(tmp_path / "F.csv", "column run numbers more than 10000 runs")
    (tmp_path / "F.csv").write_text("run,t,e,u,x\n" + "a" * 5000 + ",0,0,0,0\n")
    refused(tmp_path / "F.csv", "line 2, column run: the cell has a text too long for it")


def test_blank_lines_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pilotid.recordings.csv_table.MOST_BLANKS", 100)
    (tmp_path / "F.csv").write_text(csv_text() + ",,,\n" * 100)
    assert load_recording(tmp_path / "F.csv").samples == SAMPLES
    (tmp_path / "F.csv").write_text(csv_text() + ",,,\n" * 101)
    refused(tmp_path / "F.csv", "more than 100 blank lines follow line 242")


def test_lines_are_counted_across_blocks_and_quoted_breaks(tmp_path: Path) -> None:
    body = [f'"{n / 100}\n",1,{n % 7},1' for n in range(100_000)]
    body[90_000] = "900,1,x,1"
    (tmp_path / "F.csv").write_text("t,e,u,x\n" + "\n".join(body))
    refused(tmp_path / "F.csv", "line 180002, column u: 'x' is not a finite number")


def test_all_signals_from_one_column(tmp_path: Path) -> None:
    (tmp_path / "F.csv").write_text(csv_text())
    mapping = dict.fromkeys("eux", "t")
    np.testing.assert_array_equal(load_recording(tmp_path / "F.csv", mapping).u[0, :2], [0, DT])


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_ends_of_lines(tmp_path: Path, end: str) -> None:
    (tmp_path / "F.csv").write_bytes(csv_text().replace("\n", end).encode())
    assert load_recording(tmp_path / "F.csv").samples == SAMPLES


def test_bytes_that_are_no_text_far_into_the_file(tmp_path: Path) -> None:
    content = csv_text().encode().replace(b"\n", b",\n")
    lines = content.split(b"\n")
    lines[200] = lines[200][:-1] + b"\xff\x02"
    (tmp_path / "F.csv").write_bytes(b"\n".join(lines))
    refused(tmp_path / "F.csv", "line 201 is not UTF-8 text")


@pytest.mark.parametrize(
    ("t", "words"),
    [
        (["-1e308", "1e308"], "the time is -1e+308 s at line 2"),
        (["0", "1e200"], "the time is 1e+200 s at line 3"),
        (["0", "5e-324"], "the sampling interval is 4.941e-324 s"),
        (["0", "1e-9"], "the sampling interval is 1e-09 s"),
    ],
)
def test_absurd_times(tmp_path: Path, t: list[str], words: str) -> None:
    (tmp_path / "F.csv").write_text("t,e,u,x\n" + "".join(f"{s},1,1,1\n" for s in t))
    refused(tmp_path / "F.csv", words)


# ------------------------------------------------------------------ sidecars


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"units": {"u": "$$"}}', "'units' must be"),
        ('{"units": {"u": "\\u001b[31m"}}', "'units' must be"),
        ('{"units": {"u": "\\ud800"}}', "'units' must be"),
        ('{"units": {"u": "' + "m" * 41 + '"}}', "'units' must be"),
        ('{"controlled_element": "a\\nb"}', "'controlled_element' must be"),
        ('{"controlled_element": "\\udfff"}', "'controlled_element' must be"),
        ('{"controlled_element": "' + "s" * 201 + '"}', "'controlled_element' must be"),
        ('{"runs": 1, "runs": 1}', "gives 'runs' twice"),
        ('{"units": {"u": "m", "u": "deg"}}', "gives 'u' twice"),
        ('{"\\u001b[2J": 1}', r"unknown key '\x1b[2J'"),
        ('{"dt": 1e-310}', "says dt = 1e-310 s"),
        ('{"dt": 1e400}', "'dt' must be"),
        ('{"units": ' + "[" * 100_000 + "]" * 100_000 + "}", "cannot be read as JSON"),
        ('{"a":' * 50_000, "cannot be read as JSON"),
        (" " * (2**22 + 1), "MB large but at most 4.194 MB"),
    ],
)
def test_sidecar(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "F.csv").write_text(csv_text())
    (tmp_path / "F.json").write_text(text)
    refused(tmp_path / "F.csv", "F.json", words)


def test_sidecar_of_many_lines_is_read(tmp_path: Path) -> None:
    (tmp_path / "F.csv").write_text(csv_text())
    (tmp_path / "F.json").write_text(json.dumps({"lines": {"ft": list(range(1, 100_000))}}))
    assert len(load_recording(tmp_path / "F.csv").lines["ft"]) == 99_999


# ------------------------------------------------------------------ numbers without sense


@pytest.mark.parametrize("name", ["e", "u", "x", "ft", "fd"])
@pytest.mark.parametrize("value", [1e160, -1e160, 1e308, 1.1e100])
def test_absurdly_large_sample(name: str, value: float) -> None:
    signal = np.zeros((2, SAMPLES))
    signal[1, 11] = value
    e, u, x = np.random.default_rng(8).standard_normal((3, 2, SAMPLES))
    words = f"signal {name} is {abs(value):.3g} at sample 12 of run 2, too large for any unit"
    with pytest.raises(InputError, match=re.escape(words)):
        recording(**{"e": e, "u": u, "x": x, name: signal})


@pytest.mark.parametrize("name", ["e", "u", "x"])
@pytest.mark.parametrize("scale", [1e-310, 1e-150, 1e-102])
def test_absurdly_small_signal(name: str, scale: float) -> None:
    signal = getattr(recording(), name) * scale
    with pytest.raises(
        InputError, match=rf"signal {name} is never larger than .* of run 1, too sm"
    ):
        recording(**{name: signal})


@pytest.mark.parametrize("scale", [1e-99, 1e-9, 1e9, 1e99])
def test_other_scales_are_taken(scale: float) -> None:
    r = recording()
    u = scale * r.u
    assert recording(e=scale * r.e, u=u, x=scale * r.x).u.tobytes() == u.tobytes()


def test_zeros_and_single_tiny_samples_are_taken() -> None:
    u = np.array(recording().u)
    u[0, 5] = 1e-310  # a decaying signal passes there
    assert recording(u=u, x=np.zeros((1, SAMPLES))).u[0, 5] == 1e-310


@pytest.mark.parametrize("unit", ["$$", "$", "\x1b[31m", "m" * 41, 3])
def test_units_that_no_axis_can_bear(unit: object) -> None:
    with pytest.raises(InputError, match="the unit of u must be"):
        recording(units={"u": unit})


def test_description_of_the_element_that_no_terminal_can_bear() -> None:
    with pytest.raises(InputError, match="the description of the controlled element must be"):
        recording(controlled_element="\x1b[2J")


# ------------------------------------------------------------------ MATLAB v5


def matrix(
    name: str,
    body: bytes,
    array_class: int = 6,
    shape: tuple[int, ...] = (1, 1),
    tag: int = 14,
) -> bytes:
    """An array of a MATLAB v5 file with a body of any bytes."""
    label = name.encode()
    head = struct.pack("<IIII", 6, 8, array_class, 0)
    head += struct.pack("<II", 5, 4 * len(shape)) + struct.pack(f"<{len(shape)}i", *shape)
    head += bytes(-len(head) % 8)
    head += struct.pack("<II", 1, len(label)) + label + bytes(-len(label) % 8)
    return struct.pack("<II", tag, len(head + body)) + head + body


def doubles(count: int) -> bytes:
    return struct.pack("<II", 9, 8 * count) + bytes(8 * count)


def v5(path: Path, *elements: bytes) -> Path:
    header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path.write_bytes(header + b"".join(elements))
    return path


def compressed(element: bytes) -> bytes:
    packed = zlib.compress(element)
    return struct.pack("<II", 15, len(packed)) + packed


def good(path: Path) -> bytes:
    """The elements of a good file."""
    savemat(path, variables())
    return path.read_bytes()[128:]


def test_the_changed_byte_that_ended_the_process(tmp_path: Path) -> None:
    path = tmp_path / "F.mat"
    content = bytearray(b"".ljust(128) + good(path))
    content[:128] = path.read_bytes()[:128]
    content[176] = 0
    path.write_bytes(content)
    refused(path, "damaged or cut short", "in the variable at byte 128", "save -v7")


def test_every_single_changed_byte_of_the_first_header(tmp_path: Path) -> None:
    path = tmp_path / "F.mat"
    savemat(path, variables())
    whole = path.read_bytes()
    original = load_recording(path)
    for place in range(128, 400):
        for value in (0, 1, 7, 127, 255):
            content = bytearray(whole)
            content[place] = value
            path.write_bytes(content)
            with contextlib.suppress(InputError):
                loaded = load_recording(path)
                # the byte belongs to nothing, or to a number of the time
                assert loaded.u.tobytes() == original.u.tobytes()
                assert loaded.e.tobytes() == original.e.tobytes()


@pytest.mark.parametrize("kind", ["cell", "struct"])
def test_nested_without_end(tmp_path: Path, kind: str) -> None:
    body = doubles(1)
    depth = 50_000 if kind == "cell" else 12
    fields = struct.pack("<HHI", 5, 4, 2) + struct.pack("<II", 1, 2) + b"a\0" + bytes(6)
    element = matrix("", body)
    sizes, parts = len(element), [element]
    for level in range(depth):  # in pieces: 50,000 levels joined one by one would be quadratic
        label = b"deep" if level == depth - 1 else b""
        head = matrix(label.decode(), b"", 1 if kind == "cell" else 2)[8:]
        head += b"" if kind == "cell" else fields
        sizes += len(head) + 8
        parts.append(struct.pack("<II", 14, sizes - 8) + head)
    deep = b"".join(reversed(parts))
    path = tmp_path / "F.mat"
    assert load_recording(v5(path, deep, good(tmp_path / "G.mat"))).runs == 1
    v5(path, deep)
    refused(path, "deep" if kind == "cell" else "structs are more than 8 deep")


def test_bomb_that_is_not_needed_is_not_unpacked(tmp_path: Path) -> None:
    count = 2**22
    bomb = compressed(matrix("bomb", doubles(count), shape=(count, 1)))
    path = v5(tmp_path / "F.mat", bomb * 80, good(tmp_path / "G.mat"))
    assert path.stat().st_size < 3_000_000
    start = time.process_time()
    assert load_recording(path).runs == 1
    assert time.process_time() - start < 1.0  # unpacked, these 2.7 GB take many seconds


def test_bomb_that_is_needed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pilotid.recordings.mat_variables.MOST_VALUES", 2**20)
    count = 2**20
    bomb = compressed(matrix("fd", doubles(count), shape=(count, 1)))
    refused(v5(tmp_path / "F.mat", bomb, good(tmp_path / "G.mat")), "more than 1048576 values")


def test_bomb_of_structs_that_must_be_searched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pilotid.recordings.mat_variables.MOST_UNPACKED", 2**20)
    names = struct.pack("<HHI", 5, 4, 2) + struct.pack("<II", 1, 2) + b"a\0" + bytes(6)
    inner = matrix("", doubles(2**18), shape=(2**18, 1))
    bomb = compressed(matrix("bomb", names + inner, 2))
    refused(v5(tmp_path / "F.mat", bomb), "variables that unpack to more than 1 MB")


def test_more_variables_than_a_recording_has(tmp_path: Path) -> None:
    refused(v5(tmp_path / "F.mat", matrix("a", doubles(1)) * 30_000), "more than 10000 variables")


def test_claims_larger_than_the_file(tmp_path: Path) -> None:
    huge = (2**31 - 1, 2**31 - 1)
    many = (1,) * 40
    for body, shape, words in (
        (doubles(1), huge, "too many for a recording"),
        (doubles(1), (2, 3), "8 bytes of numbers do not fill 2 x 3"),
        (doubles(1), many, "a part claims 160 bytes"),
        (doubles(1), (-1, 1), "the size of an array is missing"),
        (struct.pack("<II", 9, 80) + bytes(8), (10, 1), "a part is larger than the whole"),
        (struct.pack("<II", 77, 8) + bytes(8), (1, 1), "numbers of the unknown kind 77"),
        (struct.pack("<II", 9 | (9 << 16), 0), (1, 1), "a small part claims 9 bytes"),
    ):
        path = v5(tmp_path / "F.mat", matrix("fd", body, shape=shape), good(tmp_path / "G.mat"))
        refused(path, "F.mat", words)


def test_the_same_variable_twice(tmp_path: Path) -> None:
    elements = good(tmp_path / "G.mat")
    refused(v5(tmp_path / "F.mat", elements, elements), "has more than one variable t")


def test_many_structs_are_searched_soon(tmp_path: Path) -> None:
    names = struct.pack("<HHI", 5, 4, 2) + struct.pack("<II", 1, 2) + b"t\0" + bytes(6)
    structs = [matrix(f"s{n}", names + matrix("", doubles(1)), 2) for n in range(4_000)]
    refused(v5(tmp_path / "F.mat", *structs), "has no variables 't', 'e', 'u', 'x'")


def test_control_characters_in_names_of_variables(tmp_path: Path) -> None:
    path = v5(tmp_path / "F.mat", matrix("\x1b[31mred\n", doubles(1)))
    refused(path, r"only \x1b[31mred")


@pytest.mark.parametrize("compression", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "?"])
def test_variables_are_those_that_scipy_reads(tmp_path: Path, kind: str, compression: bool) -> None:
    numbers = (100 * np.random.default_rng(4).random((30, 3))).astype(kind)
    content: dict[str, Any] = {
        "matrix": numbers,
        "vector": numbers[0],
        "scalar": numbers[0, 0],
        "cube": numbers.reshape(5, 1, 6, 3),
        "other_order": numbers.astype(np.dtype(kind).newbyteorder(">")),
        "text": "gain °",
        "struct": {"inner": numbers, "deep": {"text": "ab"}},
        "cells": np.array([numbers, "a"], dtype=object),
        "complex": numbers * 1j,
    }
    path = tmp_path / "F.mat"
    savemat(path, content, do_compression=compression)
    expected = loadmat(path, simplify_cells=True)
    file = MatV5(path, "F.mat")
    names = file.names(deep=True)
    assert names == [
        *("matrix", "vector", "scalar", "cube", "other_order", "text"),
        *("struct.inner", "struct.deep.text", "cells{1}", "cells{2}", "complex"),
    ]
    found = file.read(names, "")
    np.testing.assert_array_equal(found["cells{1}"], numbers)  # type: ignore[arg-type]
    assert found["cells{2}"] == "a"
    assert found["complex"] is None
    for name in names[:-3]:
        theirs: Any = expected
        for part in name.split("."):
            theirs = theirs[part]
        ours = found[name]
        assert np.shape(ours) == np.shape(theirs)
        assert np.all(np.asarray(ours) == theirs)


def test_a_recording_as_large_as_real_ones_become(tmp_path: Path) -> None:
    samples = 2**19  # nine minutes at 1 kHz; two runs suffice to see that nothing is in the way
    rng = np.random.default_rng(1)
    content: dict[str, Any] = {n: rng.standard_normal((samples, 2)) for n in ("e", "u", "x")}
    content["t"] = np.arange(samples)[:, np.newaxis] / 1000
    savemat(tmp_path / "F.mat", {"data": content})
    np.testing.assert_array_equal(load_recording(tmp_path / "F.mat").u, content["u"].T)


LIMITED = """
import resource, sys
from pathlib import Path
from pilotid.recordings.files import load_recording
from pilotid.types import InputError
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 2**28, used + 2**28))
for path in sys.argv[1:]:
    try:
        print(load_recording(path).runs)
    except InputError as error:
        print(error)
"""


def test_small_and_large_nonsense_in_little_memory(tmp_path: Path) -> None:
    count = 2**22
    bomb = compressed(matrix("bomb", doubles(count), shape=(count, 1)))
    v5(tmp_path / "bombs.mat", bomb * 40, good(tmp_path / "G.mat"))
    (tmp_path / "commas.csv").write_bytes(b"t,e,u,x\n" + b"," * 50_000_000)
    (tmp_path / "wide.csv").write_text(wide(40_000))
    names = ("bombs.mat", "commas.csv", "wide.csv")
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, *(str(tmp_path / name) for name in names)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.stderr == ""
    first, second, third = done.stdout.splitlines()
    assert first == "1"
    assert "line 2 is longer than" in second
    assert "signal e has 1 runs" in third


# ------------------------------------------------------------------ MATLAB v7.3


def test_v73(tmp_path: Path) -> None:
    for storage in (
        {},
        {"chunks": (1, 100)},
        {"chunks": (1, 50), "compression": "gzip"},
        {"chunks": True, "compression": "gzip", "shuffle": True},
    ):
        content: dict[str, Any] = {**variables(3), "note": "text", "empty": {"a": 1.0}}
        content["pilotid"] = {"units": {"u": "deg", "x": "°"}, "run_in": 1.0, "lines": {"ft": 3.0}}
        loaded = load_recording(save_v73(tmp_path / "F.mat", content, **storage))
        np.testing.assert_array_equal(loaded.u, content["u"].T)
        assert (loaded.runs, loaded.run_in) == (3, 20)
        assert loaded.units == {"u": "deg", "x": "°"}
        assert loaded.lines == {"ft": (3,)}


def test_v73_in_a_struct_and_by_mapping(tmp_path: Path) -> None:
    content = variables(2)
    path = save_v73(tmp_path / "F.mat", {"a": content, "b": variables(1)})
    refused(path, "the structs a, b all hold t, e, u, x")
    mapping = {name: f"a.{name}" for name in "teux"}
    np.testing.assert_array_equal(load_recording(path, mapping).x, content["x"].T)


def changed(path: Path, change: Callable[[Any], None], content: Mapping[str, Any]) -> Path:
    """A good v7.3 file with a change by h5py."""
    save_v73(path, content)
    with h5py.File(path, "r+") as file:
        change(file)
    return path


def without_u() -> dict[str, FloatArray]:
    return {name: value for name, value in variables().items() if name != "u"}


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda f: f.__setitem__("u", h5py.ExternalLink("other.mat", "/u")), "is a link"),
        (lambda f: f.__setitem__("u", h5py.SoftLink("/x")), "is a link"),
        (lambda f: f.__setitem__("u", h5py.SoftLink("/nowhere")), "is a link"),
        (
            lambda f: f.create_dataset(
                "u", (1, SAMPLES), "f8", external=[("/etc/passwd", 0, h5py.h5f.UNLIMITED)]
            ),
            "variable u is stored in another file",
        ),
        (
            lambda f: f.create_virtual_dataset("u", virtual()),
            "variable u is stored in another file",
        ),
        (
            lambda f: f.create_dataset("u", (1, 2**40), "f8", chunks=(1, 2**16)),
            "claims 1099511627776 values",
        ),
        (
            lambda f: f.create_dataset("u", (1, SAMPLES), "f8", chunks=(1, 10)),
            "parts of variable u are missing",
        ),
        (
            lambda f: f.create_dataset("u", (1, 10**6), "f8", chunks=(1, 1)),
            "variable u is packed in an unusual way",
        ),
        (
            lambda f: f.create_dataset("u", data=np.ones((1, SAMPLES)), compression="lzf"),
            "variable u is packed in an unusual way",
        ),
        (lambda f: bomb_in_a_chunk(f), "variable u has another size than it says"),
        (lambda f: f.create_dataset("u", (1, SAMPLES), "f8"), "parts of variable u are missing"),
        (lambda f: f.create_dataset("u", (1, SAMPLES), "c16"), "does not hold real numbers"),
        (lambda f: f.create_dataset(b"\xff\xfe", (1, 2), "f8"), r"only e, t, x, \\xff\\xfe"),
        (lambda f: f.create_dataset("\x1b[2J", (1, 2), "f8"), r"\x1b[2J"),
        (lambda f: circle(f), "structs are more than 8 deep"),
    ],
)
def test_v73_refused(tmp_path: Path, make: Callable[[Any], None], words: str) -> None:
    save_v73(tmp_path / "other.mat", variables())
    refused(changed(tmp_path / "F.mat", make, without_u()), "F.mat", words)


def bomb_in_a_chunk(file: Any) -> None:
    entry = file.create_dataset("u", (1, SAMPLES), "f8", chunks=(1, SAMPLES), compression="gzip")
    entry.id.write_direct_chunk((0, 0), zlib.compress(bytes(2**21)))


def virtual() -> Any:
    layout = h5py.VirtualLayout((1, SAMPLES), "f8")
    layout[:] = h5py.VirtualSource("other.mat", "/u", (1, SAMPLES))
    return layout


def circle(file: Any) -> None:
    group = file.create_group("a")
    group["a"] = group


def test_v73_cut_short(tmp_path: Path) -> None:
    whole = save_v73(tmp_path / "F.mat", variables()).read_bytes()
    for kept in (520, 600, 2000, len(whole) // 2, len(whole) - 1):
        (tmp_path / "G.mat").write_bytes(whole[:kept])
        refused(tmp_path / "G.mat", "damaged or cut short", "save -v7")
