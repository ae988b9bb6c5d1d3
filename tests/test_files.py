"""Recordings on disk: what is written comes back, and bad input is named in one sentence."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from pilotid.recordings.files import load_recording, parse_mapping, save_recording
from pilotid.recordings.recording import SIGNALS, Recording
from pilotid.types import FloatArray, InputError

DT = 0.05
SAMPLES = 240  # 12 s
HEADER = "t,e,u,x"


def make_recording(runs: int = 1, run_in: int = 0, dt: float = DT, **fields: object) -> Recording:
    """A recording of noise: what matters here is that every bit comes back."""
    rng = np.random.default_rng(5)
    ft, e, u, x = rng.standard_normal((4, runs, SAMPLES + run_in))
    return Recording(dt=dt, e=e, u=u, x=x, ft=ft, run_in=run_in, **fields)  # type: ignore[arg-type]


def rows(samples: int = SAMPLES, start: float = 0.0) -> list[str]:
    """The lines of a good CSV file: line n of the file is element n - 1."""
    t = start + np.arange(samples) * DT
    body = [f"{s:.2f},{np.cos(s):.4f},{np.sin(s):.4f},{np.sin(2 * s):.4f}" for s in t]
    return [HEADER, *body]


def write(path: Path, lines: list[str], end: str = "\n") -> Path:
    path.write_text(end.join(lines) + end, encoding="utf-8", newline="")
    return path


def variables(runs: int = 2) -> dict[str, FloatArray]:
    """The variables of a good MATLAB file."""
    rng = np.random.default_rng(8)
    e, u, x = rng.standard_normal((3, SAMPLES, runs))
    return {"t": np.arange(SAMPLES)[np.newaxis] * DT, "e": e, "u": u, "x": x}


def assert_equal(one: Recording, other: Recording) -> None:
    for name in SIGNALS:
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None), name
        assert a is None or (a.shape == b.shape and a.tobytes() == b.tobytes()), name
    for name in ("dt", "run_in", "lines", "units", "controlled_element"):
        assert getattr(one, name) == getattr(other, name), name


def refused(path: Path, *words: str, mapping: dict[str, str] | None = None) -> str:
    """Loading fails with one sentence that holds the file's name and these words."""
    with pytest.raises(InputError, match=re.escape(path.stem)) as caught:
        load_recording(path, mapping)
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    assert len(message) < 400
    for word in words:
        assert word in message
    return message


# ------------------------------------------------------------------ what is written comes back


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


@pytest.mark.parametrize("suffix", [".csv", ".mat"])
def test_bare_recording_is_restored(tmp_path: Path, suffix: str) -> None:
    save_recording(make_recording(), tmp_path / f"F{suffix}")
    assert_equal(load_recording(tmp_path / f"F{suffix}"), make_recording())


@pytest.mark.parametrize("suffix", [".csv", ".mat"])
@pytest.mark.parametrize("dt", [0.1, 1 / 30, 1 / 128, np.pi / 100, 0.0100000001, 8191 / 163841])
def test_sampling_interval_is_restored_exactly(tmp_path: Path, suffix: str, dt: float) -> None:
    rng = np.random.default_rng(2)
    e, u, x = rng.standard_normal((3, 1, 1600))
    recording = Recording(dt=dt, e=e, u=u, x=x, run_in=7)
    save_recording(recording, tmp_path / f"F{suffix}")
    assert_equal(load_recording(tmp_path / f"F{suffix}"), recording)


@pytest.mark.parametrize("suffix", [".csv", ".mat"])
def test_extreme_numbers_are_restored(tmp_path: Path, suffix: str) -> None:
    u = np.resize([0.1 + 0.2, -0.0, 5e-324, 1.7e30, np.nextafter(1.0, 2.0)], (1, SAMPLES))
    recording = Recording(dt=DT, e=-u, u=u, x=u / 3)
    save_recording(recording, tmp_path / f"F{suffix}")
    assert_equal(load_recording(tmp_path / f"F{suffix}"), recording)


def test_csv_columns_and_sidecar(tmp_path: Path) -> None:
    ft = np.sin(np.arange(SAMPLES + 20))[np.newaxis]
    several = make_recording(2, 20)
    recording = Recording(
        dt=DT, e=several.e, u=several.u, x=several.x, ft=ft, run_in=20, lines={"ft": (2, 3)}
    )
    save_recording(recording, tmp_path / "F.csv")
    lines = (tmp_path / "F.csv").read_text().splitlines()
    assert lines[0] == "t,e_1,e_2,u_1,u_2,x_1,x_2,ft"
    assert lines[1].startswith("-1,")
    assert lines[4].startswith("-0.85,")
    assert json.loads((tmp_path / "F.json").read_text()) == {
        "runs": 2,
        "run_in": 1.0,
        "lines": {"ft": [2, 3]},
    }
    assert sorted(p.name for p in tmp_path.iterdir()) == ["F.csv", "F.json"]
    assert_equal(load_recording(tmp_path / "F.csv"), recording)


def test_mat_holds_one_column_a_run(tmp_path: Path) -> None:
    save_recording(make_recording(2, 20, units={"e": "deg"}), tmp_path / "F.mat")
    content = loadmat(tmp_path / "F.mat", simplify_cells=True)
    assert content["u"].shape == (SAMPLES + 20, 2)
    assert content["t"][0] == -20 * DT
    assert content["pilotid"]["units"] == {"e": "deg"}
    assert content["pilotid"]["run_in"] == 1.0
    assert [p.name for p in tmp_path.iterdir()] == ["F.mat"]


def test_saving_replaces_file_and_sidecar(tmp_path: Path) -> None:
    save_recording(make_recording(3, units={"e": "deg"}), tmp_path / "F.csv")
    save_recording(make_recording(1), tmp_path / "F.csv")
    assert_equal(load_recording(tmp_path / "F.csv"), make_recording(1))


@pytest.mark.parametrize("name", ["F.txt", "F", "missing/F.csv", "missing/F.mat"])
def test_saving_where_it_cannot_be(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=re.escape(name)):
        save_recording(make_recording(), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".csv", ".mat"])
def test_saving_refuses_what_could_not_be_loaded(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(InputError, match="'units' must be"):
        save_recording(make_recording(units={"speed": "m/s"}), tmp_path / f"F{suffix}")
    assert list(tmp_path.iterdir()) == []


# ------------------------------------------------------------------ CSV as others write it


def test_plain_csv(tmp_path: Path) -> None:
    recording = load_recording(str(write(tmp_path / "F.csv", rows())))
    assert (recording.dt, recording.runs, recording.samples, recording.run_in) == (DT, 1, 240, 0)
    assert recording.ft is None
    assert recording.e[0, 0] == 1.0
    assert recording.u[0, 20] == 0.8415


@pytest.mark.parametrize(
    "spoil",
    [
        lambda lines: ["\ufeff" + lines[0], *lines[1:]],
        lambda lines: [" t , e,u ,x ", *lines[1:]],
        lambda lines: ['"t","e","u","x"', *lines[1:]],
        lambda lines: [*lines, "", "  ", ",,,"],
        lambda lines: [*lines, "\t,\t,\t,\t"],
        lambda lines: [line.replace(",", ";") for line in lines],
        lambda lines: [line.replace(",", " , ") for line in lines],
        lambda lines: ["a," + lines[0] + ",note", *("7," + line + ",text" for line in lines[1:])],
        lambda lines: [",".join(line.split(",")[::-1]) for line in lines],
    ],
    ids=[
        "mark",
        "spaces",
        "quotes",
        "blank-end",
        "tabs-end",
        "semicolons",
        "padded",
        "extra",
        "order",
    ],
)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_harmless_variants_of_csv(
    tmp_path: Path, spoil: Callable[[list[str]], list[str]], end: str
) -> None:
    plain = load_recording(write(tmp_path / "F.csv", rows()))
    assert_equal(load_recording(write(tmp_path / "G.csv", spoil(rows()), end)), plain)


def test_negative_times_are_run_in(tmp_path: Path) -> None:
    recording = load_recording(write(tmp_path / "F.csv", rows(260, start=-1.0)))
    assert (recording.run_in, recording.samples) == (20, 240)
    assert recording.time[20] == 0.0


def test_sidecar(tmp_path: Path) -> None:
    write(tmp_path / "F.csv", rows(400))
    notes = {
        "runs": 1,
        "run_in": 8.0,
        "units": {"x": "deg"},
        "lines": {"ft": [3, 5]},
        "controlled_element": "4/s",
    }
    (tmp_path / "F.json").write_text(json.dumps(notes))
    recording = load_recording(tmp_path / "F.csv")
    assert (recording.run_in, recording.samples) == (160, 240)
    assert recording.units == {"x": "deg"}
    assert recording.lines == {"ft": (3, 5)}
    assert recording.controlled_element == "4/s"


def test_sidecar_agrees_with_negative_times(tmp_path: Path) -> None:
    write(tmp_path / "F.csv", rows(260, start=-1.0))
    (tmp_path / "F.json").write_text('{"run_in": 1, "dt": 0.05}')
    assert load_recording(tmp_path / "F.csv").run_in == 20


def test_truth_beside_a_recording_is_not_read(tmp_path: Path) -> None:
    write(tmp_path / "F.csv", rows())
    (tmp_path / "F.truth.json").write_text("not even JSON")
    assert load_recording(tmp_path / "F.csv").runs == 1


def long_format(labels: list[str]) -> list[str]:
    """Runs one below the other; the run's place is added to u so that they differ."""
    lines = [f"run,{HEADER}"]
    for place, label in enumerate(labels):
        for line in rows()[1:]:
            t, e, u, x = line.split(",")
            lines.append(f"{label},{t},{e},{float(u) + place:.4f},{x}")
    return lines


def test_run_column(tmp_path: Path) -> None:
    recording = load_recording(write(tmp_path / "F.csv", long_format(["1", " 2", "b"])))
    assert (recording.runs, recording.samples) == (3, SAMPLES)
    np.testing.assert_allclose(recording.u[2] - recording.u[0], 2.0, atol=1e-12)


def test_rows_of_runs_may_alternate(tmp_path: Path) -> None:
    header, *body = long_format(["1", "2"])
    mixed = [line for pair in zip(body[:SAMPLES], body[SAMPLES:], strict=True) for line in pair]
    blocks = load_recording(write(tmp_path / "F.csv", [header, *body]))
    assert_equal(load_recording(write(tmp_path / "G.csv", [header, *mixed])), blocks)


def test_forcing_function_common_to_runs_or_one_each(tmp_path: Path) -> None:
    header = "t,u_2,u_1,e_1,e_2,x_1,x_2,ft,fd_1,fd_2"
    t = np.arange(SAMPLES) * DT
    columns = np.random.default_rng(1).standard_normal((9, SAMPLES))
    body = [",".join(map(repr, row)) for row in np.vstack([t, columns]).T.tolist()]
    recording = load_recording(write(tmp_path / "F.csv", [header, *body]))
    np.testing.assert_array_equal(recording.u, columns[[1, 0]])
    np.testing.assert_array_equal(recording.ft, columns[[6, 6]])
    np.testing.assert_array_equal(recording.fd, columns[[7, 8]])


def test_times_in_rounded_text(tmp_path: Path) -> None:
    body = [f"{n / 60:.3f},{n % 7},{n % 5},{n % 3}" for n in range(800)]
    assert load_recording(write(tmp_path / "F.csv", [HEADER, *body])).dt == 1 / 60


# ------------------------------------------------------------------ mapping


def test_parse_mapping() -> None:
    assert parse_mapping("u=-stick, e = err") == {"u": "-stick", "e": "err"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("v=stick", "unknown signal 'v'; on the left of = use one of t, e, u, x, ft, fd"),
        ("", "SIGNAL=NAME"),
        ("u", "'u' where SIGNAL=NAME"),
        ("u=a,", "SIGNAL=NAME"),
        ("u=", "u= names nothing"),
        ("u=-", "u=- names nothing"),
        ("u=a,u=b", "gives u twice"),
    ],
)
def test_bad_mapping(text: str, words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        parse_mapping(text)
    assert len(str(caught.value).splitlines()) == 1


def test_mapping_with_sign(tmp_path: Path) -> None:
    plain = load_recording(write(tmp_path / "F.csv", rows()))
    write(tmp_path / "G.csv", ["time,err,stick,x", *rows()[1:]])
    mapped = load_recording(tmp_path / "G.csv", {"t": "time", "e": "err", "u": "-stick"})
    np.testing.assert_array_equal(mapped.u, -plain.u)
    np.testing.assert_array_equal(mapped.e, plain.e)


def test_mapping_of_repeated_runs(tmp_path: Path) -> None:
    recording = make_recording(2)
    save_recording(recording, tmp_path / "F.csv")
    text = (tmp_path / "F.csv").read_text().replace("u_", "stick_")
    (tmp_path / "F.csv").write_text(text)
    np.testing.assert_array_equal(
        load_recording(tmp_path / "F.csv", {"u": "-stick"}).u, -recording.u
    )


def test_mapping_of_unknown_signal(tmp_path: Path) -> None:
    write(tmp_path / "F.csv", rows())
    with pytest.raises(InputError, match="unknown signal 'y'"):
        load_recording(tmp_path / "F.csv", {"y": "x"})


# ------------------------------------------------------------------ CSV that cannot be used


def replaced(line: int, text: str) -> list[str]:
    """A good file in which one line, counted from 1, is another."""
    lines = rows()
    lines[line - 1] = text
    return lines


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (replaced(5, "0.15,abc,0,0"), ["line 5, column e: 'abc' is not a finite number"]),
        (replaced(5, "0.15,1_0,0,0"), ["line 5, column e: '1_0' is not a finite number"]),
        (replaced(5, "0.15,0,,0"), ["line 5, column u: the cell is empty"]),
        (replaced(5, "0.15,0,0,nan"), ["line 5, column x: 'nan' is not a finite number"]),
        (replaced(5, "0.15,0,0,-inf"), ["line 5, column x: '-inf'"]),
        (replaced(5, "0.15,0,0,1e999"), ["line 5, column x: '1e999'"]),
        (replaced(5, "x" * 900 + ",0,0,0"), ["line 5, column t: 'xxx"]),
        (replaced(5, '"a\nb",0,0,0'), ["line 5, column t: 'a b'"]),
        (replaced(5, "0.15,0,0"), ["line 5 has 3 cells but the header has 4"]),
        (replaced(5, "0.15,0,0,0,"), ["line 5 has 5 cells but the header has 4"]),
        (replaced(5, ""), ["line 5 has 0 cells"]),
        (replaced(5, '0.15,"0,0,0'), ["line 5 cannot be read as comma-separated values"]),
        (replaced(5, "0.10,0,0,0"), ["time does not increase at line 5"]),
        (replaced(5, "0.05,0,0,0"), ["time does not increase at line 5"]),
        (replaced(5, "0.16,0,0,0"), ["time steps by 0.06 s at line 5 but by 0.05 s elsewhere"]),
        (rows()[:9] + rows()[10:], ["time steps by 0.1 s at line 10"]),
        (replaced(1, "t,e,v,x"), ["no column 'u' for u (control)", "t, e, v, x", "--map u="]),
        (replaced(1, "z,e,u,x"), ["no column 't' for t (time)", "z, e, u, x", "--map t=", "--dt"]),
        (
            replaced(1, "z,e,v,y"),
            ["no columns 't', 'u', 'x', only z, e, v, y", "--map t=COLUMN,u="],
        ),
        (replaced(1, "t,e,u,u"), ["more than one column 'u'"]),
        (rows()[1:], ["line 1 holds numbers but must be a header row"]),
        (replaced(1, "t,e,u,x,v"), ["line 2 has 4 cells but the header has 5"]),
        (replaced(1, "t,e,u,x,x"), ["line 1 has more than one column 'x'"]),
        (["x," + rows()[0], *("1," + r for r in rows()[1:])], ["more than one column 'x'"]),
        ([""], ["line 1 must be a header row"]),
        (replaced(1, 't,e,u,""x'), ["line 1 cannot be read as comma-separated values"]),
        (rows(0), ["holds 0 samples"]),
        (rows(1), ["holds 1 samples"]),
        (rows(199), ["lasts 9.95 s"]),
        ([HEADER, *(f"{n * 10},{n},{n},{n}" for n in range(99))], ["time in seconds"]),
        ([HEADER, *(f"{n * DT:.2f},{n},0.5,{n}" for n in range(240))], ["u is constant in run 1"]),
        ([r.replace(",", ";") for r in replaced(5, "0.15,1 5,0,0")], ["line 5, column e: '1 5'"]),
        ([r.replace(",", ";") for r in rows()[:4]] + ["0,15;0;0;0"], ["decimal point"]),
    ],
)
def test_csv_refused(tmp_path: Path, lines: list[str], words: list[str]) -> None:
    refused(write(tmp_path / "bad.csv", lines), "bad.csv", *words)


def renamed(header: str, cells: int) -> list[str]:
    return [header, *(line + ",1" * (cells - 4) for line in rows()[1:])]


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (renamed("t,e,u,x,u_1", 5), ["line 1 has the column 'u' and also u_1 for u"]),
        (renamed("t,e,u_1,x,u_3", 5), ["line 1 has the columns u_1, u_3 for u", "without a gap"]),
        (renamed("t,e,u_0,x,u_1", 5), ["number the runs from 1"]),
        (renamed("t,e,u_1,x,u_2", 5), ["signal e has 1 runs of 240 samples but u has 2"]),
        (renamed("t,e,u_1,x,u_2,run", 6), ["line 1 has a run column and also columns u_1, u_2"]),
        ([*long_format(["1", "2"])[:-1]], ["'2', which starts on line 242, has 239 rows", "240"]),
        ([*long_format(["1"]), *(f"2,{r}" for r in rows(start=1.0)[1:])], ["time on line 242"]),
        ([*long_format(["1", " "])], ["line 242, column run: the cell is empty"]),
        ([*long_format(["1", "1"])], ["time does not increase at line 242"]),
        ([*long_format([])], ["holds 0 samples"]),
    ],
)
def test_csv_runs_refused(tmp_path: Path, lines: list[str], words: list[str]) -> None:
    refused(write(tmp_path / "bad.csv", lines), "bad.csv", *words)


def test_chosen_column_must_exist_even_for_an_optional_signal(tmp_path: Path) -> None:
    path = write(tmp_path / "bad.csv", rows())
    refused(path, "no column 'target' for ft", mapping={"ft": "target"})


def test_many_columns_make_a_short_message(tmp_path: Path) -> None:
    header = ",".join(f"c{n}" for n in range(500))
    assert "c19, ..." in refused(write(tmp_path / "bad.csv", [header]), "line 1")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "line 1 must be a header row"),
        (b"t,e,u,x\n0,1,2,\xe9\n", "line 2, column x: 'é' is not a finite number"),
        (b"t,e,u,x\n0,1,2,\xe9\x02\n", "line 2 is not UTF-8"),
        ("t,e,u,x\n0,1,2,3\n".encode("utf-16"), "holds 1 samples"),
        ("t,e,u,x\n0,1,2,3\n".encode("utf-16")[:-1], "line 2 is not text"),
        (b"t,e,u,x\n0,1,2,\x00\n1,1,1,1\n", "line 2, column x"),
        (b"t,e,u,x\n0,1,2," + b"9" * 200_000 + b"\n", "line 2 cannot be read"),
        (bytes(range(256)), "not UTF-8"),
    ],
)
def test_bytes_that_are_no_csv(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "bad.csv").write_bytes(content)
    refused(tmp_path / "bad.csv", "bad.csv", words)


@pytest.mark.parametrize("name", ["bad.doc", "bad", "bad.xlsx"])
def test_other_suffix(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("t")
    refused(tmp_path / name, name, ".csv or a .mat file")


@pytest.mark.parametrize("name", ["bad.csv", "bad.mat"])
def test_missing_file_and_folder(tmp_path: Path, name: str) -> None:
    refused(tmp_path / name, name, "no such file")
    (tmp_path / name).mkdir()
    refused(tmp_path / name, name, "cannot be read")


def test_message_names_the_path_as_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "bad.csv", rows(20))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"^\./bad\.csv: "):
        load_recording("./bad.csv")


# ------------------------------------------------------------------ sidecars that cannot be used


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"runs": 1,\n "units": }', "line 2 is not valid JSON"),
        ("", "line 1 is not valid JSON"),
        ("[1]", "must be one object"),
        ('{"run-in": 8}', "unknown key 'run-in'; the known ones are runs, run_in, dt, units"),
        ('{"runs": 2}', "says 2 runs but"),
        ('{"runs": 0}', "'runs' must be"),
        ('{"runs": 1.5}', "'runs' must be"),
        ('{"runs": true}', "'runs' must be"),
        ('{"runs": null}', "'runs' must be"),
        ('{"run_in": 2.0}', "says run_in = 2 s but 1 s of"),
        ('{"run_in": 0}', "says run_in = 0 s but 1 s of"),
        ('{"run_in": -1}', "'run_in' must be"),
        ('{"run_in": NaN}', "'run_in' must be"),
        ('{"run_in": Infinity}', "'run_in' must be"),
        ('{"run_in": 1' + "0" * 400 + "}", "'run_in' must be"),
        ('{"run_in": 1' + "0" * 9000 + "}", "cannot be read as JSON"),
        ("[" * 100_000, "cannot be read as JSON"),
        ('{"dt": 0}', "'dt' must be"),
        ('{"dt": 0.06}', "says dt = 0.06 s but the time"),
        ('{"units": "deg"}', "'units' must be"),
        ('{"units": {"y": "deg"}}', "'units' must be"),
        ('{"units": {"x": 1}}', "'units' must be"),
        ('{"lines": [1, 2]}', "'lines' must be"),
        ('{"lines": {"u": [1]}}', "'lines' must be"),
        ('{"lines": {"ft": 3}}', "'lines' must be"),
        ('{"lines": {"ft": [1, 0]}}', "'lines' must be"),
        ('{"lines": {"ft": [1, "2"]}}', "'lines' must be"),
        ('{"controlled_element": 4}', "'controlled_element' must be"),
    ],
)
def test_sidecar_refused(tmp_path: Path, text: str, words: str) -> None:
    path = write(tmp_path / "bad.csv", rows(260, start=-1.0))
    (tmp_path / "bad.json").write_text(text)
    refused(path, "bad.json", words)


def test_sidecar_that_is_no_text(tmp_path: Path) -> None:
    path = write(tmp_path / "bad.csv", rows())
    (tmp_path / "bad.json").write_bytes(b"\n\xff")
    refused(path, "bad.json: line 2 is not UTF-8")
    (tmp_path / "bad.json").unlink()
    (tmp_path / "bad.json").mkdir()
    refused(path, "bad.json: cannot be read")


def test_run_in_of_the_sidecar_longer_than_the_recording(tmp_path: Path) -> None:
    path = write(tmp_path / "bad.csv", rows())
    (tmp_path / "bad.json").write_text('{"run_in": 12}')
    refused(path, "bad.csv", "run-in (240 samples) must be shorter")


# ------------------------------------------------------------------ MATLAB files


def saved(path: Path, content: Mapping[str, object]) -> Path:
    savemat(path, dict(content))
    return path


def test_mat_columns_are_runs(tmp_path: Path) -> None:
    content = variables(3)
    recording = load_recording(saved(tmp_path / "F.mat", content))
    assert (recording.dt, recording.runs, recording.samples, recording.run_in) == (DT, 3, 240, 0)
    np.testing.assert_array_equal(recording.u, content["u"].T)


@pytest.mark.parametrize("shape", [(1, SAMPLES), (SAMPLES, 1)])
def test_mat_vectors_are_one_run(tmp_path: Path, shape: tuple[int, int]) -> None:
    content = {name: value.reshape(shape) for name, value in variables(1).items()}
    content["ft"] = content["e"] + content["x"]
    recording = load_recording(saved(tmp_path / "F.mat", content))
    assert recording.runs == 1
    np.testing.assert_array_equal(recording.x[0], content["x"].ravel())


def test_mat_forcing_functions(tmp_path: Path) -> None:
    content = variables(2)
    content["ft"] = np.arange(float(SAMPLES))[np.newaxis]
    content["fd"] = content["u"][:, ::-1]
    recording = load_recording(saved(tmp_path / "F.mat", content))
    np.testing.assert_array_equal(recording.ft, [np.arange(SAMPLES)] * 2)
    np.testing.assert_array_equal(recording.fd, content["fd"].T)


def test_mat_negative_times_are_run_in(tmp_path: Path) -> None:
    content = variables()
    content["t"] = content["t"] - 1.0
    assert load_recording(saved(tmp_path / "F.mat", content)).run_in == 20


def test_mat_single_precision_and_integers(tmp_path: Path) -> None:
    content = variables()
    content["u"] = (100 * content["u"]).astype(np.int16)
    content["t"] = content["t"].astype(np.float32)
    recording = load_recording(saved(tmp_path / "F.mat", content))
    assert recording.dt == DT
    np.testing.assert_array_equal(recording.u, content["u"].T)


def test_mat_mapping_with_sign(tmp_path: Path) -> None:
    content = variables()
    content["stick"] = content.pop("u")
    recording = load_recording(saved(tmp_path / "F.mat", content), {"u": "-stick"})
    np.testing.assert_array_equal(recording.u, -content["stick"].T)


@pytest.mark.parametrize("depth", [1, 2])
def test_mat_struct(tmp_path: Path, depth: int) -> None:
    plain = load_recording(saved(tmp_path / "F.mat", variables()))
    content: dict[str, object] = dict(variables())
    for _ in range(depth):
        content = {"data": content, "comment": "pilot 3"}
    assert_equal(load_recording(saved(tmp_path / "G.mat", content)), plain)


def test_mat_time_beside_a_struct(tmp_path: Path) -> None:
    plain = load_recording(saved(tmp_path / "F.mat", variables()))
    inner: dict[str, object] = dict(variables())
    content = {"t": inner.pop("t"), "data": inner}
    assert_equal(load_recording(saved(tmp_path / "G.mat", content)), plain)


def test_mat_top_level_comes_before_structs(tmp_path: Path) -> None:
    plain = load_recording(saved(tmp_path / "F.mat", variables()))
    content = {**variables(), "other": {**variables(), "ft": np.zeros(3)}}
    assert_equal(load_recording(saved(tmp_path / "G.mat", content)), plain)


def test_mat_one_struct_of_several_by_mapping(tmp_path: Path) -> None:
    plain = load_recording(saved(tmp_path / "F.mat", variables()))
    path = saved(tmp_path / "bad.mat", {"a": variables(3), "b": variables()})
    message = refused(path, "the structs a, b all hold t, e, u, x", "t=a.t,e=a.e,u=a.u,x=a.x")
    mapping = parse_mapping(message.rpartition("--map ")[2].replace("a.", "b."))
    assert_equal(load_recording(path, mapping), plain)


def test_mat_several_candidates_in_one_struct(tmp_path: Path) -> None:
    path = saved(tmp_path / "bad.mat", {"d": {**variables(), "fit": {"u": variables()["u"]}}})
    refused(path, "u may be any of d.u, d.fit.u", "--map u=d.u")
    assert load_recording(path, {"u": "d.u"}).runs == 2


def spoilt(**changes: object) -> dict[str, object]:
    """The variables of a good file with some changed, or left out where None."""
    content = {**variables(), **changes}
    return {name: value for name, value in content.items() if value is not None}


GAP = np.delete(np.arange(SAMPLES + 1), 7) * DT
NOT_A_NUMBER = np.where(np.arange(2 * SAMPLES).reshape(SAMPLES, 2) == 21, np.nan, 1.0)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (spoilt(u=None), ["has no variable 'u' for u (control), only t, e, x", "--map u="]),
        (spoilt(u=None, s={"v": 1.0}), ["has no variable 'u'", "s.v"]),
        ({}, ["has no variables 't', 'e', 'u', 'x', only none"]),
        (spoilt(u=variables()["u"][1:].T), ["variable u is 2 x 239 but the time has 240 samples"]),
        (spoilt(u=np.ones((100, 2))), ["variable u is 100 x 2"]),
        (spoilt(u=np.ones(100)), ["variable u is 100 samples long"]),
        (spoilt(u=np.ones((240, 2, 2))), ["variable u is 240 x 2 x 2"]),
        (spoilt(u=3.0), ["variable u is 1 samples long"]),
        (spoilt(u="text"), ["variable u does not hold real numbers"]),
        (spoilt(u=variables()["u"] * 1j), ["variable u does not hold real numbers"]),
        (spoilt(u=np.array([1, "a"], dtype=object)), ["variable u{2} does not hold real numbers"]),
        (spoilt(u=np.zeros((0, 0))), ["variable u is"]),
        (spoilt(u=NOT_A_NUMBER), ["variable u is not a finite number at row 11, column 2"]),
        (spoilt(t=np.full(SAMPLES, np.inf)), ["variable t is not a finite number at row 1;"]),
        (spoilt(t=variables()["u"]), ["variable t (time) is 240 x 2"]),
        (spoilt(t=np.zeros(SAMPLES)), ["time does not increase at sample 2 of t"]),
        (spoilt(t=GAP), ["time steps by 0.1 s at sample 8 of t"]),
        (spoilt(x=variables()["x"][:, :1]), ["signal x"]),
        (spoilt(u=np.ones((SAMPLES, 2))), ["u is constant in run 1"]),
        (spoilt(pilotid={"runs": 3}), ["variable pilotid: says 3 runs"]),
        (spoilt(pilotid={"speed": 3}), ["variable pilotid: unknown key 'speed'"]),
        (spoilt(pilotid=3.0), ["variable pilotid: must be one object"]),
        (spoilt(pilotid={"lines": {"ft": "abc"}}), ["variable pilotid: 'lines' must be"]),
    ],
)
def test_mat_refused(tmp_path: Path, content: dict[str, object], words: list[str]) -> None:
    refused(saved(tmp_path / "bad.mat", content), "bad.mat", *words)


def test_mat_chosen_variable_must_exist(tmp_path: Path) -> None:
    path = saved(tmp_path / "bad.mat", variables())
    refused(path, "no variable 'target' for ft", mapping={"ft": "target"})


def test_mat_version_4(tmp_path: Path) -> None:
    savemat(tmp_path / "F.mat", variables(), format="4")
    savemat(tmp_path / "G.mat", variables())
    assert_equal(load_recording(tmp_path / "F.mat"), load_recording(tmp_path / "G.mat"))


@pytest.mark.parametrize("content", [b"", b"t,e,u,x\n" * 99, bytes(600), b"\xff" * 600])
def test_bytes_that_are_no_mat_file(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bad.mat").write_bytes(content)
    refused(tmp_path / "bad.mat", "bad.mat", "not a MATLAB v5 file")


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kept", [128, 132, 200, 1000, 5000])
def test_mat_file_cut_short(tmp_path: Path, kept: int, compressed: bool) -> None:
    savemat(tmp_path / "whole.mat", variables(), do_compression=compressed)
    (tmp_path / "bad.mat").write_bytes((tmp_path / "whole.mat").read_bytes()[:kept])
    refused(tmp_path / "bad.mat", "bad.mat")


def test_mat_file_with_damaged_bytes(tmp_path: Path) -> None:
    savemat(tmp_path / "whole.mat", variables(), do_compression=True)
    content = bytearray((tmp_path / "whole.mat").read_bytes())
    content[300:400] = bytes(100)
    (tmp_path / "bad.mat").write_bytes(content)
    refused(tmp_path / "bad.mat", "bad.mat", "damaged or cut short", "save -v7")


HDF = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(384) + b"\x89HDF\r\n\x1a\n"


def test_mat_version_73_without_reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    (tmp_path / "bad.mat").write_bytes(HDF)
    refused(tmp_path / "bad.mat", "v7.3", "save -v7", "pilotid[matlab]")


# ------------------------------------------------------------------ real recordings


def test_measured_yaw(measured: Path) -> None:
    files = sorted(measured.glob("yaw/*.mat"))
    assert len(files) >= 12
    for file in files:
        recording = load_recording(file)
        assert (recording.runs, recording.samples, recording.run_in) == (5, 8192, 0)
        assert recording.dt == 0.01
        assert recording.ft is not None
        assert recording.fd is not None
        np.testing.assert_allclose(recording.e, recording.ft - recording.x, atol=1e-4)


def test_measured_rollpitch(measured: Path) -> None:
    files = sorted(measured.glob("rollpitch/pilot*.csv"))
    assert len(files) >= 12
    for file in files:
        recording = load_recording(file)
        assert (recording.runs, recording.samples, recording.run_in) == (1, 8192, 0)
        assert recording.dt == 0.01
        assert recording.ft is not None
        np.testing.assert_allclose(recording.e, recording.ft - recording.x, atol=1e-4)


@pytest.mark.parametrize("suffix", [".csv", ".mat"])
def test_measured_recording_survives_saving(measured: Path, tmp_path: Path, suffix: str) -> None:
    recording = load_recording(measured / "yaw" / "ae2224I_measurement_data_subj1_C3.mat")
    save_recording(recording, tmp_path / f"F{suffix}")
    assert_equal(load_recording(tmp_path / f"F{suffix}"), recording)
