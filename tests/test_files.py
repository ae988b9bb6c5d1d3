"""Files of recordings: each kind is read, or refused in one sentence that names the place."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from matlab_files import USERBLOCK, save_v73
from scipy.io import savemat

from pilotid.recording.files import load_recording, save_recording
from pilotid.recording.recording import SIGNALS, Recording
from pilotid.support.types import FloatArray, InputError

HEADER = "t,e,u,x"
Writer = Callable[[Path], Path]
DT, SAMPLES = 0.05, 240  # 12 s
T = np.round(np.arange(SAMPLES) * DT, 2)
FT, X, U = np.round(np.random.default_rng(6).standard_normal((3, 2, SAMPLES)), 4)
E = np.round(FT - X, 4)
ONE = {"t": T, "e": E[0], "u": U[0], "x": X[0]}
TWO: dict[str, Any] = {"t": T[:, None], "e": E.T, "u": U.T, "x": X.T}


def text(
    header: str = "t,e,u,x",
    separator: str = ",",
    *,
    decimal: str = ".",
    columns: dict[str, FloatArray] | None = None,
    before: str = "",
    under: str = "",
    end: str = "\n",
) -> str:
    """A file of one run: what stands before and under the header, and how numbers are written."""
    rows = zip(*(columns or ONE).values(), strict=True)
    body = [separator.join(f"{v:.4f}".replace(".", decimal) for v in row) for row in rows]
    return end.join([*before.splitlines(), header, *under.splitlines(), *body, ""])


def written(content: str | bytes, name: str = "F.csv") -> Writer:
    def write(folder: Path) -> Path:
        data = content.encode() if isinstance(content, str) else content
        (folder / name).write_bytes(data)
        return folder / name

    return write


def saved(content: dict[str, Any], **options: Any) -> Writer:
    def write(folder: Path) -> Path:
        savemat(folder / "F.mat", content, **options)
        return folder / "F.mat"

    return write


def saved_73(content: dict[str, Any]) -> Writer:
    return lambda folder: save_v73(folder / "F.mat", content)


def structs(runs: list[dict[str, Any]]) -> np.ndarray[Any, Any]:
    """An array of structs as `savemat` wants it."""
    array = np.empty(len(runs), dtype=[(name, object) for name in runs[0]])
    for i, run in enumerate(runs):
        for name, value in run.items():
            array[i][name] = value
    return array


def cells(values: Any) -> np.ndarray[Any, Any]:
    array = np.empty(len(values), dtype=object)
    array[:] = [*values]
    return array


def run(i: int, **changes: Any) -> dict[str, Any]:
    return {"t": T, "e": E[i], "u": U[i], "x": X[i], **changes}


def with_table() -> bytes:
    """A v5 file with one table, as MATLAB writes objects: its content lies elsewhere."""

    def element(number: int, content: bytes) -> bytes:
        return struct.pack("<II", number, len(content)) + content + bytes(-len(content) % 8)

    array = element(6, struct.pack("<II", 6, 0)) + element(5, struct.pack("<II", 1, 1))
    array += element(1, b"") + element(9, bytes(8))
    parts = element(6, struct.pack("<II", 17, 0))
    parts += b"".join(element(1, word.encode()) for word in ("T", "MCOS", "table"))
    parts += element(14, array)
    return b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + element(14, parts)


def numpy_file(content: Any, name: str) -> Writer:
    def write(folder: Path) -> Path:
        np.savez(folder / name, **content)
        return folder / name

    return write


def hdf5(content: dict[str, Any]) -> Writer:
    """Groups, arrays and tables as h5py writes them, under names with slashes."""

    def write(folder: Path) -> Path:
        with h5py.File(folder / "F.h5", "w") as file:
            for name, values in content.items():
                file[name] = values
        return folder / "F.h5"

    return write


def part(write: Writer, name: str) -> Writer:
    return lambda folder: Path(f"{write(folder)}::{name}")


def references_73(folder: Path, kind: str) -> Path:
    """A v7.3 file with cells or an array of structs, by places of data elsewhere in the file."""
    path = folder / "F.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        hidden = file.create_group("#refs#")
        group = file if kind == "cells" else file.create_group("data")
        for name, runs in (("e", E), ("u", U), ("x", X), ("t", [T, T])):
            places = []
            for i, values in enumerate(runs):
                entry = hidden.create_dataset(f"{name}{i}", data=np.atleast_2d(values))
                entry.attrs["MATLAB_class"] = np.bytes_("double")
                places.append(entry.ref)
            holder = group.create_dataset(name, (1, 2), dtype=h5py.ref_dtype)
            holder[0] = places
            if kind == "cells":
                holder.attrs["MATLAB_class"] = np.bytes_("cell")
    with path.open("r+b") as stream:
        stream.write(USERBLOCK)
    return path


def rows(samples: int = SAMPLES, start: float = 0.0) -> list[str]:
    """The lines of a good CSV file: line n of the file is element n - 1."""
    t = start + np.arange(samples) * DT
    body = [f"{s:.2f},{np.cos(s):.4f},{np.sin(s):.4f},{np.sin(2 * s):.4f}" for s in t]
    return [HEADER, *body]


def long_format(labels: list[str]) -> list[str]:
    """Runs one below the other; the run's place is added to u so that they differ."""
    lines = [f"run,{HEADER}"]
    for place, label in enumerate(labels):
        for line in rows()[1:]:
            t, e, u, x = line.split(",")
            lines.append(f"{label},{t},{e},{float(u) + place:.4f},{x}")
    return lines


def replaced(line: int, text: str) -> list[str]:
    """A good file in which one line, counted from 1, is another."""
    lines = rows()
    lines[line - 1] = text
    return lines


def renamed(header: str, cells: int) -> list[str]:
    return [header, *(line + ",1" * (cells - 4) for line in rows()[1:])]


def spoilt(**changes: object) -> dict[str, object]:
    """The variables of a good file with some changed, or left out where None."""
    content = {**TWO, **changes}
    return {name: value for name, value in content.items() if value is not None}


NOT_A_NUMBER = np.where(np.arange(2 * SAMPLES).reshape(SAMPLES, 2) == 21, np.nan, 1.0)


# ------------------------------------------------------------------ what is read


UNITS = {"e": "deg", "u": "-", "x": "deg"}
GERMAN = text(separator=";", header="t;e;u;x", decimal=",")
QUOTED = "t,e,u,x\n" + "".join(
    ",".join(f'"{v:.4f}"'.replace(".", ",") for v in row) + "\n"
    for row in zip(*ONE.values(), strict=True)
)
SHORT = {name: value[:-1] for name, value in ONE.items()}

#: Name, file, how many runs, and what else is expected or given: units, mapping, dt.
READ: list[tuple[str, Writer, int, dict[str, Any]]] = [
    ("plain", written(text()), 1, {}),
    ("semicolons", written(text("t;e;u;x", ";")), 1, {}),
    ("semicolons and decimal commas", written(GERMAN), 1, {}),
    ("tabs", written(text("t\te\tu\tx", "\t"), "F.txt"), 1, {}),
    ("spaces", written(text("t   e u  x ", "   "), "F.dat"), 1, {}),
    ("quoted decimal commas", written(QUOTED), 1, {}),
    ("row of units", written(text(under="s,deg,-,deg")), 1, {"units": UNITS}),
    ("units in names", written(text("t [s],e [deg],u (-),x[deg]")), 1, {"units": UNITS}),
    ("upper case", written(text("T,E,U,X")), 1, {}),
    ("Latin-1 units", written(text("t,e [°],u,x [°]").encode("latin-1")), 1, {"unit": "°"}),
    ("UTF-16", written(text("t\te\tu\tx", "\t").encode("utf-16")), 1, {}),
    ("sep=;", written(text("t;e;u;x", ";", before="sep=;")), 1, {}),
    ("comments", written(text(before="# pilot 3\n% yaw, gain")), 1, {}),
    ("header in a comment", written(text("# t,e,u,x", before="# by savetxt")), 1, {}),
    ("milliseconds", written(text("t [ms],e,u,x", columns={**ONE, "t": 1000 * T})), 1,
     {"map": "t=0.001*t"}),
    ("no time", written(text("e,u,x", columns={k: ONE[k] for k in "eux"})), 1, {"dt": DT}),
    ("no x", written(text("t,e,u,ft", columns={**ONE, "x": FT[0]})), 1, {"from": "ft - e"}),
    ("no e", written(text("t,ft,u,x", columns={**ONE, "e": FT[0]})), 1, {}),
    ("other names", written(text("t,err [deg],stick,x")), 1, {"map": "e=err,u=stick"}),
    ("MATLAB columns are runs", saved(TWO), 2, {}),
    ("MATLAB rows are runs", saved({k: v.T for k, v in TWO.items()}), 2, {}),
    ("MATLAB v4", saved(TWO, format="4"), 2, {}),
    ("MATLAB v7.3", saved_73(TWO), 2, {}),
    ("MATLAB upper case", saved({k.upper(): v for k, v in TWO.items()}), 2, {}),
    ("MATLAB struct with fields", saved({"data": TWO, "subject": "3"}), 2, {}),
    ("MATLAB array of structs", saved({"data": structs([run(0), run(1)])}), 2, {}),
    ("MATLAB array of structs, mapped", saved({"D": structs([run(0), run(1)])}), 2,
     {"map": "t=D.t,u=D.u"}),
    ("MATLAB cells of runs", saved({"t": T, "e": cells(E), "u": cells(U), "x": cells(X)}), 2, {}),
    ("MATLAB cells of structs", saved({"runs": cells([run(0), run(1)])}), 2, {}),
    ("MATLAB v7.3 cells", lambda folder: references_73(folder, "cells"), 2, {}),
    ("MATLAB v7.3 array of structs", lambda folder: references_73(folder, "structs"), 2, {}),
    ("MATLAB time a column a run", saved({**TWO, "t": np.tile(T[:, None], 2)}), 2, {}),
    ("MATLAB no time", saved({k: v for k, v in TWO.items() if k != "t"}), 2, {"dt": DT}),
    ("MATLAB no x", saved({**{k: TWO[k] for k in "teu"}, "ft": FT.T}), 2, {"from": "ft - e"}),
    ("blank lines among comments", written(text(before="# pilot 3\n\n# gain\n\n")), 1, {}),
    ("comment under the header", written(text(under="# pilot 3, gain")), 1, {}),
    ("last name for all columns", written(text("# t,e,u,x...", columns={**ONE, "y": FT[0]})), 1,
     {"map": "x=x"}),
    ("second of two columns", written(text("t,e,u,x,x", columns={**{k: ONE[k] for k in "teu"},
                                                                 "y": FT[0], "x": X[0]})), 1,
     {"map": "x=x.1"}),
    ("npz", numpy_file(TWO, "F.npz"), 2, {}),
    ("HDF5", hdf5({k: v.T for k, v in TWO.items()}), 2, {}),
    ("struct of a file", part(saved({"t": T, "a": {k: TWO[k] for k in "eux"}, "b": run(1)}), "a"),
     2, {}),
    ("runs by a variable", part(saved({**TWO, "sigma": [3, 17]}), "sigma=3.0"), 1, {}),
]  # fmt: skip


@pytest.mark.parametrize(("write", "runs", "more"), [k[1:] for k in READ], ids=[k[0] for k in READ])
def test_kind_is_read(tmp_path: Path, write: Writer, runs: int, more: dict[str, Any]) -> None:
    recording = load_recording(write(tmp_path), more.get("map"), more.get("dt"))
    assert (recording.dt, recording.run_in) == (DT, 0)
    for name, values in (("e", E), ("u", U), ("x", X)):
        np.testing.assert_allclose(getattr(recording, name), values[:runs], atol=2e-12)
    if "units" in more:
        assert recording.units == more["units"]
    if "unit" in more:
        assert recording.units == {"e": more["unit"], "x": more["unit"]}
    if "from" in more:
        assert recording.origin["x"] == more["from"]


# ------------------------------------------------------------------ what is refused


#: Name, file, and what the sentence must say.
REFUSED: list[tuple[str, Writer, list[str]]] = [
    ("comments that name no columns", written(text("# pilot 3").replace("\n", "\n# t,e,u\n", 1)),
     ["has no header row, line 3 holds numbers"]),
    ("several missing", written(text("time,err,stick,phi")),
     ["'t'", "'e'", "'u'", "t=NAME,e=NAME,u=NAME"]),
    ("no time and no rate", written(text("e,u,x", columns={k: ONE[k] for k in "eux"})),
     ["no 't' for t (time)", "--dt 0.01"]),
    ("two units of one name", written(text("t,e [deg],e [rad],u")), ["may be e", "e=e [deg]"]),
    ("unit of time", written(text("t [min],e,u,x")), ["the time is in 'min'", "t=0.001*NAME"]),
    ("decimal commas between commas", written(text(decimal=",")),
     ["line 2 has 8 cells, the header 4", "semicolons"]),
    ("mixed decimals", written(GERMAN.replace(",", ".", 300)),
     ["F.csv: line 77, column u"]),
    ("empty cells", written(text() + "12.00,,,\n12.05,1,1,1\n"), ["line 242, column u: ''"]),
    ("a spreadsheet", written(b"PK\x03\x04", "F.xlsx"), [".csv or a .mat file", ".npz"]),
    ("binary", written(bytes(range(256)) * 9), ["has 1 cells, the header 2"]),
    ("MATLAB table", written(with_table(), "F.mat"),
     ["only None<no matrix of real numbers>"]),
    ("MATLAB runs of unequal length", saved({"d": structs([run(0), {**SHORT}])}),
     ["run 2, is 239", "240 samples", "runs at one length"]),
    ("MATLAB runs at other times", saved({"d": structs([run(0), run(1, t=T + 1.0)])}),
     ["alike in all runs, but run 2, from 1 s on"]),
    ("MATLAB two arrays of structs",
     saved({"a": structs([run(0)] * 2), "b": structs([run(1)] * 2)}),
     ["only a{1}.t", "F.mat::a"]),
    ("MATLAB no such part", part(saved({"a": run(0)}), "b"), ["no part 'b', only a"]),
    ("no such level", part(saved({**TWO, "sigma": [3, 17]}), "sigma=4"),
     ["no run has 'sigma=4', sigma is 3, 17"]),
    ("levels of no runs", part(saved({**TWO, "sigma": [3, 17, 5]}), "sigma=3"),
     ["choose by one number for each of the 2 runs"]),
    ("part of a table", part(written(text()), "a"), ["has no part 'a', only none"]),
    ("several rates", saved({**ONE, "u": np.repeat(U[0], 2)}), ["480", "at one rate"]),
    ("npz of objects", numpy_file({**ONE, "u": np.array([{}, 1])}, "F.npz"),
     ["only t, e, u<no matrix of real numbers>, x"]),
    ("npz cut short", written(b"PK\x03\x04" + bytes(99), "F.npz"), ["no .npz file"]),
    ("HDF5 of other bytes", written(bytes(999), "F.h5"), ["no .h5 file"]),
]  # fmt: skip

#: Lines of a CSV file, and what the sentence must say.
REFUSED_LINES: list[tuple[list[str], list[str]]] = [
    (replaced(5, "0.15,abc,0,0"), ["line 5, column e: 'abc' is no finite number"]),
    (replaced(5, ""), ["line 5 has 0 cells"]),
    ([*rows()[:5], *[",,,"] * 100_000, *rows()[5:]], ["line 6, column u: ''"]),
    (replaced(5, '0.15,"0,0,0'), ["line 5 has 0 cells"]),
    (replaced(5, "0.05,0,0,0"), ["run 1, from 0 s on, has a step of 0.15 s behind 0.05 s"]),
    (rows()[:9] + rows()[10:], ["a step of 0.1 s behind 0.35 s"]),
    (replaced(1, "t,e,v,x"), ["no 'u' for u (control)", "t, e, v, x", "--map u="]),
    (replaced(1, "z,e,u,x"), ["no 't' for t (time)", "z, e, u, x", "--map t=", "--dt"]),
    (replaced(1, "t,e,u,u"), ["F.csv: u, u.1 may be u", "--map u=u"]),
    (rows()[1:], ["has no header row, line 1 holds numbers", "above it, as in t,e,u,x"]),
    (["x," + rows()[0], *("1," + r for r in rows()[1:])], ["F.csv: x, x.1 may be x"]),
    (rows(199), ["lasts 9.95 s"]),
    ([HEADER, *(f"{n * 10},{n},{n},{n}" for n in range(99))], ["time in seconds"]),
    ([HEADER, *(f"{n * DT:.2f},{n},0.5,{n}" for n in range(240))], ["u is constant in run 1"]),
    ([r.replace(",", ";") for r in replaced(5, "0.15,1 5,0,0")], ["line 5, column e: '1 5'"]),
    ([r.replace(",", ";") for r in rows()[:4]] + ["0,15;0;0;0"], ["decimal point"]),
    (renamed("t,e,u_1,x,u_3", 5), ["F.csv: u_1, u_3 may be u", "without a gap"]),
    (renamed("t,e,u_0,x,u_1", 5), ["F.csv: u_0, u_1 may be u"]),
    (renamed("t,e,u_1,x,u_2", 5), ["signal e is of the shape (1, 240) and u of (2, 240)"]),
    (renamed("t,e,u_1,x,u_2,run", 6), ["F.csv: has no 'u'"]),
    ([*long_format(["1", "2"])[:-1]], ["run 2, is 239", "240"]),
    (
        [*long_format(["1"]), *(f"2,{r}" for r in rows(start=1.0)[1:])],
        ["alike in all runs, but run 2, from 1 s on", "begin all runs at one time"],
    ),
    ([*long_format(["1", "1"])], ["a step of -11.95 s behind 11.95 s", "number runs"]),
    (["run,t,e,u,x", "a,0,0,0,0"], ["holds 1 samples"]),
]

#: Bytes of a CSV file.
REFUSED_BYTES: list[tuple[bytes, list[str]]] = [
    (b"", ["cannot be read (it is empty)"]),
    (b" \n\n", ["has no 't'"]),
    (b"t,e,u,x\n0,1,2,\xe9\n", ["line 2, column x: 'é' is no finite number"]),
]

#: The sidecar of a file with a run-in of 1 s.
REFUSED_NOTES: list[tuple[str, list[str]]] = [
    ('{"runs": 1,\n "units": }', ["F.json", "line 2"]),
    ('{"run-in": 8}', ["F.json: run-in", "the keys are runs, run_in, dt, units"]),
    ('{"runs": 2}', ["F.csv: holds 1 runs", "2 runs"]),
    ('{"run_in": 2.0}', ["F.csv: holds 1 runs and 20 samples of run-in", "40 samples"]),
    ('{"run_in": -1}', ["F.json: run_in"]),
    ('{"dt": 0.06}', ["F.csv: --dt or the note dt says 0.06 s"]),
    ('{"units": {"y": "deg"}}', ["F.json", "units: 'y'"]),
    ('{"lines": {"ft": [1, "2"]}}', ["F.json: lines.ft.1"]),
    ('{"units": {"u": "' + "m" * 41 + '"}}', ["F.json: units.u"]),
]

#: The variables of a MATLAB file.
REFUSED_VARIABLES: list[tuple[dict[str, object], list[str]]] = [
    (spoilt(u=None), ["has no 'u' for u (control), only t, e, x", "--map u="]),
    ({}, ["'t'", "'e'", "'u'"]),
    (spoilt(u=TWO["u"][1:].T), ["t, run 1, is 240", "239"]),
    (spoilt(u=np.ones((240, 2, 2))), ["u, run 1, is 240 x 2 x 2"]),
    (spoilt(u=3.0), ["the first run of u has 1 samples"]),
    (spoilt(u=TWO["u"] * 1j), ["only t, e, u<no matrix of real numbers>, x"]),
    (spoilt(u=np.array([1, "a"], dtype=object)), ["the first run of u has 1 samples"]),
    (spoilt(u=NOT_A_NUMBER), ["sample 11 of run 2"]),
    (spoilt(t=TWO["u"]), ["evenly", "run 1"]),
    (spoilt(t=np.zeros(SAMPLES)), ["a step of 0 s behind 0 s"]),
]


#: Files that are cut, and what is no file at all.
REFUSED_STORAGE: list[tuple[Writer, list[str]]] = [
    (lambda folder: cut(save_v73(folder / "F.mat", ONE), 2000), ["damaged"]),
    (lambda folder: cut(saved(ONE, do_compression=True)(folder), 5000), ["damaged"]),
    (written(b"t,e,u,x\n" * 99, "F.mat"), ["damaged"]),
    (lambda folder: folder / "F.csv", ["No such file"]),
    (lambda folder: made(folder / "F.csv", Path.mkdir), ["cannot be read"]),
]


def cut(path: Path, size: int) -> Path:
    path.write_bytes(path.read_bytes()[:size])
    return path


def made(path: Path, make: Callable[[Path], object]) -> Path:
    make(path)
    return path


def with_notes(notes: str | bytes) -> Writer:
    def write(folder: Path) -> Path:
        written(notes, "F.json")(folder)
        return written("\n".join(rows(260, start=-1.0)))(folder)

    return write


ALL_REFUSED: list[tuple[Writer, list[str]]] = [
    *((write, words) for _, write, words in REFUSED),
    *((written("\n".join(lines) + "\n"), words) for lines, words in REFUSED_LINES),
    *((written(content), words) for content, words in REFUSED_BYTES),
    *((with_notes(notes), words) for notes, words in REFUSED_NOTES),
    (with_notes(b"\n\xff"), ["F.json", "line 2"]),
    *((saved(content), words) for content, words in REFUSED_VARIABLES),
    *REFUSED_STORAGE,
]


@pytest.mark.parametrize(("write", "words"), ALL_REFUSED)
def test_what_cannot_be_used_is_refused_in_a_sentence(
    tmp_path: Path, write: Writer, words: list[str]
) -> None:
    path = write(tmp_path)
    with pytest.raises(InputError) as caught:
        load_recording(path)
    message = str(caught.value)
    assert message.isprintable()
    assert len(message.replace(str(tmp_path), "")) < 400
    for word in words:
        assert word in message


def assert_equal(one: Recording, other: Recording) -> None:
    for name in SIGNALS:
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None), name
        assert a is None or (a.shape == b.shape and a.tobytes() == b.tobytes()), name
    for name in ("dt", "run_in", "lines", "units", "controlled_element"):
        assert getattr(one, name) == getattr(other, name), name


# ------------------------------------------------------------------ variants of one file


PLAIN_LINES: list[Callable[[list[str]], list[str]]] = [
    lambda lines: ["\ufeff" + lines[0], *lines[1:]],
    lambda lines: [" t , e,u ,x ", *lines[1:]],
    lambda lines: ['"t","e","u","x"', *lines[1:]],
    lambda lines: [*lines, "", "  ", ",,,"],
    lambda lines: [*lines, "\t,\t,\t,\t", *[",,,"] * 100_000],
    lambda lines: [line.replace(",", " , ") for line in lines],
    lambda lines: ["a," + lines[0] + ",note", *("7," + line + ",text" for line in lines[1:])],
    lambda lines: [",".join(line.split(",")[::-1]) for line in lines],
]


@pytest.mark.parametrize("change", PLAIN_LINES)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_harmless_variants_of_csv(
    tmp_path: Path, change: Callable[[list[str]], list[str]], end: str
) -> None:
    plain = load_recording(written("\n".join(rows()))(tmp_path))
    path = tmp_path / "G.csv"
    path.write_text(end.join([*change(rows()), ""]), newline="")
    assert_equal(load_recording(path), plain)


def test_rows_of_runs_may_alternate(tmp_path: Path) -> None:
    header, *body = long_format(["1", " 2"])
    mixed = [line for pair in zip(body[:SAMPLES], body[SAMPLES:], strict=True) for line in pair]
    blocks = load_recording(written("\n".join([header, *body]))(tmp_path))
    assert (blocks.runs, blocks.samples) == (2, SAMPLES)
    np.testing.assert_allclose(blocks.u[1] - blocks.u[0], 1.0, atol=1e-12)
    assert_equal(load_recording(written("\n".join([header, *mixed]))(tmp_path)), blocks)


def test_forcing_function_common_to_runs_or_one_each(tmp_path: Path) -> None:
    header = "t,u_2,u_1,e_1,e_2,x_1,x_2,ft,fd_1,fd_2"
    columns = np.random.default_rng(1).standard_normal((9, SAMPLES))
    body = [",".join(map(repr, row)) for row in np.vstack([T, columns]).T.tolist()]
    recording = load_recording(written("\n".join([header, *body]))(tmp_path))
    np.testing.assert_array_equal(recording.u, columns[[1, 0]])
    np.testing.assert_array_equal(recording.ft, columns[[6, 6]])
    np.testing.assert_array_equal(recording.fd, columns[[7, 8]])


@pytest.mark.parametrize("notes", ['{"run_in": 1, "dt": 0.05}', "{}"])
def test_negative_times_are_run_in(tmp_path: Path, notes: str) -> None:
    (tmp_path / "F.truth.json").write_text("not read, and not even JSON")
    recording = load_recording(with_notes(notes)(tmp_path))
    assert (recording.run_in, recording.samples) == (20, 240)
    assert recording.time[20] == 0.0


def test_storage_and_notes_of_v73(tmp_path: Path) -> None:
    notes = {"units": {"u": "deg", "x": "°"}, "run_in": 1.0, "lines": {"ft": [3]}}
    (tmp_path / "F.json").write_text(json.dumps(notes))
    for storage in (
        {},
        {"chunks": (1, 50), "compression": "gzip"},
        {"chunks": True, "shuffle": True},
    ):
        content: dict[str, Any] = {**TWO, "note": "text", "empty": {"a": 1.0}}
        content = {**content, "t": np.arange(SAMPLES + 20)[:, None] * DT}
        for name in "eux":
            content[name] = np.tile(TWO[name], (2, 1))[: SAMPLES + 20]
        loaded = load_recording(save_v73(tmp_path / "F.mat", content, **storage))
        np.testing.assert_array_equal(loaded.u, content["u"].T)
        assert (loaded.runs, loaded.run_in) == (2, 20)
        assert loaded.units == {"u": "deg", "x": "°"}
        assert loaded.lines == {"ft": (3,)}


# ------------------------------------------------------------------ what is written comes back


def make_recording(runs: int = 1, run_in: int = 0, **fields: Any) -> Recording:
    """A recording of noise: what matters here is that every bit comes back."""
    ft, e, u, x = np.random.default_rng(5).standard_normal((4, runs, SAMPLES + run_in))
    return Recording(dt=DT, e=e, u=u, x=x, ft=ft, run_in=run_in, **fields)


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".CSV"])
@pytest.mark.parametrize("runs", [1, 3])
@pytest.mark.parametrize("run_in", [0, 40])
def test_saved_recording_is_restored_to_the_bit(
    tmp_path: Path, suffix: str, runs: int, run_in: int
) -> None:
    recording = make_recording(
        runs,
        run_in,
        lines={"ft": (3, 7, 11), "fd": (5,)},
        units={"e": "deg", "u": ""},
        controlled_element="4 / (s (s + 1)), gain °",
    )
    path = tmp_path / f"F{suffix}"
    save_recording(recording, path)
    loaded = load_recording(path)
    assert_equal(loaded, recording)
    assert loaded.source == str(path)
    save_recording(make_recording(), path)  # replaces the file and its notes
    assert_equal(load_recording(path), make_recording())


@pytest.mark.parametrize("suffix", [".csv", ".mat"])
@pytest.mark.parametrize("dt", [0.1, 1 / 30, 1 / 128, np.pi / 100, 0.0100000001, 8191 / 163841])
def test_sampling_interval_is_restored_exactly(tmp_path: Path, suffix: str, dt: float) -> None:
    e, u, x = np.random.default_rng(2).standard_normal((3, 1, 1600))
    recording = Recording(dt=dt, e=e, u=u, x=x, run_in=7)
    save_recording(recording, tmp_path / f"F{suffix}")
    assert_equal(load_recording(tmp_path / f"F{suffix}"), recording)


# ------------------------------------------------------------------ names, rates, measured files


def test_mapping(tmp_path: Path) -> None:
    runs = make_recording(2)
    save_recording(runs, tmp_path / "F.csv")
    content = (tmp_path / "F.csv").read_text().replace("u_", "stick_")
    for mapping in ({"u": "-stick"}, "u = -stick, e=e"):
        loaded = load_recording(written(content, "G.csv")(tmp_path), mapping)
        np.testing.assert_array_equal(loaded.u, -runs.u)
    with pytest.raises(InputError, match="or u a second time"):
        load_recording(tmp_path / "G.csv", "u=stick,u=e")
    loaded = load_recording(saved({**TWO, "stick": TWO["u"]})(tmp_path), {"u": "-stick"})
    np.testing.assert_array_equal(loaded.u, -U)
    for path in (tmp_path / "F.csv", tmp_path / "F.mat"):
        with pytest.raises(InputError, match="'target' for ft"):
            load_recording(path, {"ft": "target"})
        for name, text in (("y_1", "y_1=x"), ("", "u=x,"), ("", "=x")):
            with pytest.raises(InputError, match=f"cannot be named '{name}'"):
                load_recording(path, text)


def test_advice_of_a_refusal_can_be_followed(tmp_path: Path) -> None:
    path = saved({"a": structs([run(0), run(1)]), "b": structs([run(1), run(0)])})(tmp_path)
    with pytest.raises(InputError) as caught:
        load_recording(path)
    advised = str(caught.value).rpartition("as in ")[2]
    np.testing.assert_array_equal(load_recording(advised).u, U)
    np.testing.assert_array_equal(load_recording(advised[:-1] + "b").u, U[::-1])


def test_the_sampling_interval_must_agree_with_the_time(tmp_path: Path) -> None:
    path = written(text())(tmp_path)
    assert load_recording(path, dt=DT).dt == DT
    with pytest.raises(InputError, match=r"dt says 0.01 s but the samples are 0.05 s apart"):
        load_recording(path, dt=0.01)
    (tmp_path / "F.json").write_text('{"dt": 0.05}')
    written(text("e,u,x", columns={k: ONE[k] for k in "eux"}))(tmp_path)
    assert load_recording(path).dt == DT
    with pytest.raises(
        InputError, match=r"the note dt says 0.05 s but the samples are 0.01 s apart"
    ):
        load_recording(path, dt=0.01)


@pytest.mark.parametrize(("names", "runs"), [("yaw/*.mat", 5), ("rollpitch/pilot*.csv", 1)])
def test_measured_files_are_read(measured: Path, names: str, runs: int) -> None:
    files = sorted(measured.glob(names))
    assert len(files) >= 12
    for file in files:
        recording = load_recording(file)
        assert (recording.runs, recording.samples, recording.run_in) == (runs, 8192, 0)
        assert recording.dt == 0.01
        assert recording.ft is not None
        assert runs == 1 or recording.fd is not None
        np.testing.assert_allclose(recording.e, recording.ft - recording.x, atol=1e-4)


def test_a_signal_is_multiplied_by_the_factor_before_its_name(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    rows = [f"{0.01 * i},{i % 7},{i % 5},{i % 3},{i % 4}" for i in range(1200)]
    file.write_text("\n".join(["t,e,u,x,d", *rows]), encoding="utf-8")
    plain = load_recording(file, mapping={"fd": "d"})
    scaled = load_recording(file, mapping={"fd": "-3.49*d", "u": "2e-1 * u"})
    assert plain.fd is not None
    assert scaled.fd is not None
    np.testing.assert_allclose(scaled.fd, -3.49 * plain.fd)
    np.testing.assert_allclose(scaled.u, 0.2 * plain.u)
    assert scaled.scaled("fd", -1.0) == "fd=3.49*d"
    assert scaled.flipped("e", "u") == "e=-e,u=-0.2*u"
    with pytest.raises(InputError, match="names nothing"):
        load_recording(file, mapping={"fd": "0*d"})
    with pytest.raises(InputError, match=r"no '1\.2\.3\*d'"):
        load_recording(file, mapping={"fd": "1.2.3*d"})
