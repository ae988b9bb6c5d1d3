"""Kinds of files that laboratories have: each is read, or refused in a sentence that helps."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from matlab_files import USERBLOCK, save_v73
from scipy.io import savemat

from pilotid.recordings.files import load_recording, parse_mapping, save_recording
from pilotid.recordings.recording import Recording
from pilotid.types import FloatArray, InputError

DT, SAMPLES = 0.05, 240  # 12 s
T = np.round(np.arange(SAMPLES) * DT, 2)
FT, X, U, FD = np.round(np.random.default_rng(6).standard_normal((4, 2, SAMPLES)), 4)
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


def written(content: str | bytes, name: str = "F.csv") -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        data = content.encode() if isinstance(content, str) else content
        (folder / name).write_bytes(data)
        return folder / name

    return write


def saved(content: dict[str, Any], **options: Any) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        savemat(folder / "F.mat", content, **options)
        return folder / "F.mat"

    return write


def saved_73(content: dict[str, Any]) -> Callable[[Path], Path]:
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


def with_object(kind: str, name: str = "T") -> bytes:
    """A v5 file with one object, as MATLAB writes tables: its content lies elsewhere."""

    def element(number: int, content: bytes) -> bytes:
        return struct.pack("<II", number, len(content)) + content + bytes(-len(content) % 8)

    parts = element(6, struct.pack("<II", 17, 0))
    parts += b"".join(element(1, word.encode()) for word in (name, "MCOS", kind))
    return b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + element(14, parts)


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


UNITS = {"e": "deg", "u": "-", "x": "deg"}
GERMAN = text(separator=";", header="t;e;u;x", decimal=",")
QUOTED = "t,e,u,x\n" + "".join(
    ",".join(f'"{v:.4f}"'.replace(".", ",") for v in row) + "\n"
    for row in zip(*ONE.values(), strict=True)
)
SHORT = {name: value[:-1] for name, value in ONE.items()}

#: Name, file, how many runs, and what else is expected or given: units, mapping, dt.
READ: list[tuple[str, Callable[[Path], Path], int, dict[str, Any]]] = [
    ("plain", written(text()), 1, {}),
    ("semicolons", written(text("t;e;u;x", ";")), 1, {}),
    ("semicolons and decimal commas", written(GERMAN), 1, {}),
    ("tabs", written(text("t\te\tu\tx", "\t"), "F.txt"), 1, {}),
    ("tabs and decimal commas", written(text("t\te\tu\tx", "\t", decimal=","), "F.tsv"), 1, {}),
    ("spaces", written(text("t   e u  x ", "   "), "F.dat"), 1, {}),
    ("quoted decimal commas", written(QUOTED), 1, {}),
    ("sep=;", written(text("t;e;u;x", ";", before="sep=;")), 1, {}),
    ("sep=tab", written(text("t\te\tu\tx", "\t", before="SEP=\t", end="\r\n")), 1, {}),
    ("row of units", written(text(under="s,deg,-,deg")), 1, {"units": UNITS}),
    ("row of units in brackets", written(text(under="[s],[deg],[-],(deg)")), 1, {"units": UNITS}),
    ("units in names", written(text("t [s],e [deg],u (-),x[deg]")), 1, {"units": UNITS}),
    ("upper case", written(text("T,E,U,X")), 1, {}),
    ("upper case with units", written(text("T [S],E [deg],U [-],X [deg]")), 1, {"units": UNITS}),
    ("Latin-1 units", written(text("t,e [°],u,x [°]").encode("latin-1")), 1, {"unit": "°"}),
    ("UTF-16 with mark", written(text("t\te\tu\tx", "\t").encode("utf-16")), 1, {}),
    ("UTF-16 without mark", written(text().encode("utf-16-le")), 1, {}),
    ("UTF-16 the other way round", written(text().encode("utf-16-be")), 1, {}),
    ("comments", written(text(before="# pilot 3\n% yaw, gain")), 1, {}),
    ("header in a comment", written(text("# t,e,u,x", before="# by savetxt")), 1, {}),
    ("milliseconds", written(text("t [ms],e,u,x", columns={**ONE, "t": 1000 * T})), 1, {}),
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
    ("MATLAB array of structs, mapped", saved({"d": structs([run(0), run(1)])}), 2,
     {"map": "t=d.t,u=d.u"}),
    ("MATLAB structs in a struct", saved({"s": {"runs": structs([run(0), run(1)])}}), 2, {}),
    ("MATLAB cells of runs", saved({"t": T, "e": cells(E), "u": cells(U), "x": cells(X)}), 2, {}),
    ("MATLAB cells of structs", saved({"runs": cells([run(0), run(1)])}), 2, {}),
    ("MATLAB v7.3 cells", lambda folder: references_73(folder, "cells"), 2, {}),
    ("MATLAB v7.3 array of structs", lambda folder: references_73(folder, "structs"), 2, {}),
    ("MATLAB time a column a run", saved({**TWO, "t": np.tile(T[:, None], 2)}), 2, {}),
    ("MATLAB no time", saved({k: v for k, v in TWO.items() if k != "t"}), 2, {"dt": DT}),
    ("MATLAB no x", saved({**{k: TWO[k] for k in "teu"}, "ft": FT.T}), 2, {"from": "ft - e"}),
]  # fmt: skip

CODES = [np.where(np.arange(SAMPLES) % 9 == 4, code, ONE["e"]) for code in (-9999.0, 1e30, 1e308)]

#: Name, file, and what the sentence must say.
REFUSED: list[tuple[str, Callable[[Path], Path], list[str]]] = [
    ("no names", written(text().partition("\n")[2]), ["line 1 holds numbers", "header row"]),
    ("several missing", written(text("time,err,stick,phi")),
     ["no columns 't', 'e', 'u', 'x', only time, err, stick, phi", "t=COLUMN,e=COLUMN,u=COLUMN"]),
    ("no time and no rate", written(text("e,u,x", columns={k: ONE[k] for k in "eux"})),
     ["no column 't' for t (time)", "--dt 0.01"]),
    ("two units of one name", written(text("t,e [deg],e [rad],u")), ["may be e", "e=e [deg]"]),
    ("two cases of one name", written(text("t,e,U [-],U [V]")), ["any of which may be u"]),
    ("unit of time", written(text("t [min],e,u,x")), ["the unit of the time is 'min'", "in s, ms"]),
    ("decimal commas between commas", written(text(decimal=",")),
     ["line 2 has 8 cells but the header has 4", "semicolons"]),
    ("mixed decimals", written(GERMAN.replace(",", ".", 300)),
     ["'0.0000' is not a finite number; write a decimal comma"]),
    ("code -9999", written(text(columns={**ONE, "e": CODES[0]})),
     ["signal e is -9999 at 27 samples", "a code for missing values"]),
    ("code 1e30", saved({**ONE, "e": CODES[1]}), ["signal e is 1e+30 at 27 samples"]),
    ("code 1e308", saved({**ONE, "x": CODES[2]}), ["signal x is 1e+308 at 27 samples"]),
    ("empty cells", written(text() + "12.00,,,\n12.05,1,1,1\n"), ["the cell is empty"]),
    ("NaN", saved({**ONE, "u": np.where(T == 3.0, np.nan, U[0])}), ["u is not a finite number"]),
    ("a spreadsheet", written(b"PK\x03\x04", "F.xlsx"), [".csv or a .mat file"]),
    ("binary", written(bytes(range(256)) * 9), ["is not UTF-8 text"]),
    ("MATLAB table", written(with_object("table"), "F.mat"),
     ["variable T is a MATLAB table", "table2struct(T,'ToScalar',true)"]),
    ("MATLAB timetable", written(with_object("timetable"), "F.mat"),
     ["variable T is a MATLAB timetable", "timetable2table(T)", "seconds(S.Time)"]),
    ("MATLAB time series", written(with_object("timeseries", "stick"), "F.mat"),
     ["variable stick is a MATLAB timeseries", "stick.Data"]),
    ("MATLAB runs of unequal length", saved({"d": structs([run(0), {**SHORT}])}),
     ["d(2).t", "239 samples", "cut all runs to the same length"]),
    ("MATLAB runs at other times", saved({"d": structs([run(0), run(1, t=T + 1.0)])}),
     ["variable d(2).t (time) differs from d(1).t"]),
    ("MATLAB two arrays of structs",
     saved({"a": structs([run(0)] * 2), "b": structs([run(1)] * 2)}),
     ["the structs a, b all hold t, e, u, x", "--map t=a.t,e=a.e,u=a.u,x=a.x"]),
    ("MATLAB several missing", saved({"time": T, "err": E[0]}),
     ["no variables 't', 'e', 'u', 'x'"]),
]  # fmt: skip


@pytest.mark.parametrize(("write", "runs", "more"), [k[1:] for k in READ], ids=[k[0] for k in READ])
def test_kind_is_read(
    tmp_path: Path, write: Callable[[Path], Path], runs: int, more: dict[str, Any]
) -> None:
    mapping = parse_mapping(more["map"]) if "map" in more else None
    recording = load_recording(write(tmp_path), mapping, more.get("dt"))
    assert (recording.dt, recording.run_in) == (DT, 0)
    for name, values in (("e", E), ("u", U), ("x", X)):
        np.testing.assert_allclose(getattr(recording, name), values[:runs], atol=2e-12)
    if "units" in more:
        assert recording.units == more["units"]
    if "unit" in more:
        assert recording.units == {"e": more["unit"], "x": more["unit"]}
    if "from" in more:
        assert recording.origin["x"] == more["from"]


@pytest.mark.parametrize(("write", "words"), [k[1:] for k in REFUSED], ids=[k[0] for k in REFUSED])
def test_kind_is_refused_in_a_sentence(
    tmp_path: Path, write: Callable[[Path], Path], words: list[str]
) -> None:
    path = write(tmp_path)
    with pytest.raises(InputError) as caught:
        load_recording(path)
    message = str(caught.value)
    assert path.name in message
    assert message.isprintable()
    assert len(message.replace(str(tmp_path), "")) < 330
    for word in words:
        assert word in message


def test_there_are_forty_kinds() -> None:
    assert len(READ) + len(REFUSED) >= 40


def test_advice_of_a_refusal_can_be_followed(tmp_path: Path) -> None:
    path = saved({"a": structs([run(0), run(1)]), "b": structs([run(1), run(0)])})(tmp_path)
    with pytest.raises(InputError) as caught:
        load_recording(path)
    mapping = parse_mapping(str(caught.value).rpartition("--map ")[2].replace("a.", "b."))
    np.testing.assert_array_equal(load_recording(path, mapping).u, U[::-1])


def test_a_recording_without_x_suits_models_that_act_on_e(tmp_path: Path) -> None:
    path = written(text("t,e,u", columns={k: ONE[k] for k in "teu"}))(tmp_path)
    recording = load_recording(path)
    assert recording.signals == ["e", "u"]
    save_recording(recording, tmp_path / "G.csv")
    assert load_recording(tmp_path / "G.csv").signals == ["e", "u"]


def test_the_sampling_interval_must_agree_with_the_time(tmp_path: Path) -> None:
    path = written(text())(tmp_path)
    assert load_recording(path, dt=DT).dt == DT
    with pytest.raises(InputError, match=r"time steps by 0.05 s but --dt says 0.01 s"):
        load_recording(path, dt=0.01)
    (tmp_path / "F.json").write_text('{"dt": 0.05}')
    written(text("e,u,x", columns={k: ONE[k] for k in "eux"}))(tmp_path)
    assert load_recording(path).dt == DT
    with pytest.raises(InputError, match=r"says dt = 0.05 s but --dt says 0.01 s"):
        load_recording(path, dt=0.01)


def test_a_code_is_told_from_a_large_signal() -> None:
    from pilotid.recordings.contents import refuse_codes

    counts = np.linspace(-9999.0, 9999.0, 401)[None]
    refuse_codes(counts, "u", "F")
    refuse_codes(np.full((1, 3), -9999.0), "u", "F")
    with pytest.raises(
        InputError, match="is 9999 at 1 sample, the first of them sample 2 of run 1"
    ):
        refuse_codes(np.array([[0.0, 9999.0, 100.0]]), "u", "F")


def test_origins_are_kept(tmp_path: Path) -> None:
    path = written(text("T [s],err,Stick (-),x"))(tmp_path)
    recording: Recording = load_recording(path, {"e": "err", "u": "-stick"})
    assert recording.origin == {"t": "T [s]", "e": "err", "u": "-Stick (-)", "x": "x"}
    np.testing.assert_allclose(recording.u, -U[:1])
