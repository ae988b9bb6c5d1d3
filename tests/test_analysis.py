"""`pilotid analyse`: from files to tables."""

from __future__ import annotations

import csv
import json
import re
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from helpers import PILOTS, Run

import pilotid
from pilotid.datasets import simulate
from pilotid.experiment.files import fields_of, parts_of
from pilotid.experiment.fits import Answer, Task
from pilotid.model.loops import margins
from pilotid.recording.files import Reading, save_recording
from pilotid.support.jobs import Loss
from pilotid.support.numbers import recording_rng

PATTERN = "s{subject}_{condition}"
OPTIONS = ("--per-run", "--left-out", "--sensitivity")
#: One process: to start a second one takes longer than the few fits that it would do.
ALONE = ("--workers", "1")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two subjects under two conditions, two runs each, and a file that cannot be read."""
    folder = tmp_path_factory.mktemp("laboratory")
    for subject in (1, 2):
        for condition, name in (("A", "single"), ("B", "lead-lag")):
            scenario = replace(PILOTS[name], runs=2)
            recording = simulate(scenario, recording_rng(subject, condition))
            save_recording(recording, folder / f"s{subject}_{condition}.csv")
    (folder / "s3_A.csv").write_text("t,e,u\n0,1,2\n")
    return folder


#: How the small folder is analysed: one model, one process.
SMALL = ("--pattern", PATTERN, "--model", "single", *ALONE)


def small_files(small: Path) -> list[Path]:
    return [small / f"s{name}.csv" for name in ("1_A", "1_B", "2_A", "2_B")]


@pytest.fixture(scope="module")
def small(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same folder, s2_A a copy of s1_A, analysed."""
    from pilotid.cli.main import main

    small = tmp_path_factory.mktemp("small")
    for file in small_files(small):
        source = "s1_A.csv" if file.name == "s2_A.csv" else file.name
        shutil.copy(folder / source, file)
    with redirect_stdout(StringIO()) as printed, pytest.raises(SystemExit) as end:
        main(["analyse", *map(str, small_files(small)), *SMALL, "--out", str(small / "out")])
    assert end.value.code == 0
    (small / "printed.txt").write_text(printed.getvalue(), encoding="utf-8")
    return small


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def analysed(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    from pilotid.cli.main import main

    out = tmp_path_factory.mktemp("results")
    files = [str(path) for path in sorted(folder.glob("*.csv"))]
    with pytest.raises(SystemExit) as end:
        main(["analyse", *files, "--pattern", PATTERN, *OPTIONS, "--out", str(out)])
    assert end.value.code == 2  # one file is bad, and was said to be
    return out


@pytest.mark.numerical
@pytest.mark.long
def test_every_fit_is_a_row(analysed: Path) -> None:
    every = table(analysed / "estimates.csv")
    assert {r["model"] for r in every if r["method"] == "measured"} == {""}
    rows = [r for r in every if r["method"] != "measured"]
    assert {r["subject"] + r["condition"] for r in rows} == {"1A", "1B", "2A", "2B"}
    assert {r["run"] for r in rows} == {"", "1", "2"}
    own = {(r["condition"], r["model"]) for r in rows if r["run"]}
    assert own == {("A", "single"), ("B", "lead-lag")}
    truth = dict(zip(PILOTS["single"].model.keys, PILOTS["single"].truth, strict=True))
    inside = [
        float(r["lower_95"]) <= truth[r["parameter"]] <= float(r["upper_95"])
        for r in rows
        if (r["condition"], r["model"]) == ("A", "single") and r["parameter"] in truth
    ]
    assert len(inside) == 30  # two subjects, pooled and two runs, five parameters
    assert sum(inside) > 22


@pytest.mark.numerical
@pytest.mark.long
def test_every_run_is_predicted_by_the_fit_of_the_others(analysed: Path) -> None:
    rows = table(analysed / "left_out.csv")
    every = ["1A1", "1A2", "1B1", "1B2", "2A1", "2A2", "2B1", "2B2"]
    assert [r["subject"] + r["condition"] + r["run"] for r in rows] == every
    assert {(r["condition"], r["model"]) for r in rows} == {("A", "single"), ("B", "lead-lag")}
    assert all(20.0 < float(r["vaf"]) < 100.0 for r in rows)
    assert all(r["log_likelihood"] and r["outcome"] for r in rows)


def test_a_second_call_does_nothing_again(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with sqlite3.connect(small / "out" / "study.sqlite") as base:
        assert base.execute("SELECT count(*) FROM rows").fetchone() == (2 * 4,)
    base.close()
    out = small / "out"
    before = (out / "estimates.csv").read_bytes()

    def refuse(_: object, tasks: list[object], *__: object, **___: object) -> list[object]:
        assert not tasks
        return []

    monkeypatch.setattr("pilotid.experiment.fits.run_tasks", refuse)
    (out / "estimates.csv").unlink()
    found = pilotid.analyse(small_files(small), PATTERN, "single", out=out)
    assert found.write() == out / "report.html"
    assert (out / "estimates.csv").read_bytes() == before
    assert str(found) in (small / "printed.txt").read_text("utf-8")
    frame = found.to_dataframe()
    assert list(frame["parameter"]) == [row["parameter"] for row in table(out / "estimates.csv")]
    assert [*found.to_dataframe("models")] == [*table(out / "models.csv")[0]]


def test_lost_fits_are_named_and_what_needs_no_model_stays(
    small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(small / "out" / "study.sqlite", tmp_path)

    def lose(
        _: object, tasks: list[Task], lost: Callable[..., Answer], *__: object, **___: object
    ) -> list[Answer]:
        return [lost(task, Loss.DIED, "exit code 3") for task in tasks]

    monkeypatch.setattr("pilotid.experiment.fits.run_tasks", lose)
    files = small_files(small)
    found = pilotid.analyse(files, PATTERN, "single", "fourier", out=tmp_path)
    assert found.refused == [f"{file}: its process died (exit code 3)" for file in files]
    assert found.write().is_file()
    assert {*found.to_dataframe()["method"]} == {"measured"}


def test_why_a_method_objects_is_said(small: Path, tmp_path: Path) -> None:
    files, cut = small_files(small)[:1], Reading(span="0:40")
    found = pilotid.analyse(files, PATTERN, "single", "fourier", out=tmp_path, reading=cut)
    assert "subject 1 condition A: not applicable to this recording (ft is no" in str(found)
    fits = found.to_dataframe().query("method == 'fourier'")
    assert fits["remarks"].str.contains("recording (ft is no", regex=False).all()


@pytest.mark.numerical
@pytest.mark.long
def test_estimates_shift_by_few_errors_where_a_sound_pilot_is_fitted_otherwise(
    analysed: Path,
) -> None:
    page = (analysed / "report.html").read_text(encoding="utf-8")
    table = page[page.index("Shifts of estimates") :].partition("</table>")[0]
    assert table.count("lead-in 3 s longer") == 2  # a row for each condition
    cells = re.findall(r"<td[^>]*>([^<]+)</td>", table)
    shifts = [float(cell.replace("\N{MINUS SIGN}", "-")) for cell in cells if cell[-1:].isdigit()]
    assert len(shifts) > 30
    assert np.median(np.abs(shifts)) < 1.5


def test_a_bad_file_is_named_and_costs_no_other(folder: Path, run: Run, tmp_path: Path) -> None:
    answer = run("analyse", folder / "s3_A.csv", "--pattern", PATTERN, "--out", tmp_path)
    assert answer.status == 2
    assert "s3_A.csv" in answer.err
    assert "Traceback" not in answer.err


@pytest.mark.parametrize(
    ("pattern", "name", "found"),
    [
        ("subj{subject}_{condition}", "data_subj1_C2.mat", {"subject": "1", "condition": "C2"}),
        ("pilot{s}_{c}_{axis}", "pilot7_C1_roll.mat", {"s": "7", "c": "C1", "axis": "roll"}),
        ("{subject}-{condition}", "P01-B.csv", {"subject": "P01", "condition": "B"}),
        ("Subj{subject}", "subj12.csv", {"subject": "12"}),
        ("{subject}/{condition}", "lab/anna/C3.csv", {"subject": "anna", "condition": "C3"}),
        ("s{subject}_{condition}", "t1_A.csv", None),
        ("x{condition}", "x_.csv", None),
        ("sigma={condition}", "lab/data.mat::sigma=17.5", {"condition": "17.5"}),
        ("{s}::{condition}", "data.h5::b.1", {"s": "data", "condition": "b.1"}),
    ],
)
def test_patterns(pattern: str, name: str, found: dict[str, str] | None) -> None:
    assert fields_of(Path(name), pattern) == found


def test_files_that_differ_in_the_run_are_one_recording() -> None:
    files = [Path(f"p1_C{c}_run{r}_pitch.csv") for c in (1, 2) for r in (2, 10, 1)]
    parts, refused = parts_of(files, "p{subject}_{condition}_run{run}_{axis}")
    assert not refused
    assert [[f.name for f in part.files] for part in parts] == [
        [f"p1_C{c}_run{r}_pitch.csv" for r in (1, 2, 10)] for c in (1, 2)
    ]
    assert parts[0].fields == {"subject": "1", "condition": "C1", "axis": "pitch"}


def test_files_with_the_same_fields_are_refused() -> None:
    files = [Path("a/s1_A.csv"), Path("b/s1_A.csv"), Path("b/other.csv")]
    parts, refused = parts_of(files, PATTERN)
    assert len(parts) == 1
    assert len(refused) == 2
    assert "s1_A.csv" in refused[0]
    assert "does not fit" in refused[1]


@pytest.mark.numerical
@pytest.mark.long
def test_loops_are_those_of_the_simulated_element(analysed: Path) -> None:
    rows = table(analysed / "loops.csv")
    scenario = PILOTS["single"]
    target, disturbance = margins(scenario.model, scenario.values, scenario.element)
    truth = {
        "target_crossover": target.crossover,
        "target_phase_margin": target.phase_margin,
        "disturbance_crossover": disturbance.crossover,
        "disturbance_phase_margin": disturbance.phase_margin,
    }
    for name in ("target", "disturbance"):
        late = np.radians(90.0 - truth[f"{name}_phase_margin"]) / truth[f"{name}_crossover"]
        truth[f"{name}_effective_delay"] = late
    own = [r for r in rows if r["condition"] == "A" and not r["run"]]
    assert {r["quantity"] for r in own} == set(truth)
    for row in own:
        off = abs(float(row["value"]) - truth[row["quantity"]])
        assert off < 4.0 * float(row["std_error"]), row
        assert row["element"] == scenario.element.name


@pytest.mark.long
def test_the_same_analysis_gives_the_same_bytes(
    analysed: Path, folder: Path, run: Run, tmp_path: Path
) -> None:
    """On one machine; the store alone may differ."""
    names = ("estimates.csv", "models.csv", "loops.csv", "contrasts.csv")
    files = sorted(folder.glob("s[12]_*.csv"))
    options = ("--per-run", *ALONE, "--out", tmp_path)
    answer = run("analyse", *files, "--pattern", PATTERN, *options)
    assert answer.status == 0, answer.err
    for name in names:
        assert (tmp_path / name).read_bytes() == (analysed / name).read_bytes(), name


@pytest.mark.parametrize("text", ["C3", "C3:", ":C6", ""])
def test_contrasts_that_make_no_sense_are_refused(folder: Path, run: Run, text: str) -> None:
    answer = run(
        "analyse", folder / "s1_A.csv", "--pattern", PATTERN, "--contrast", text, "--out", folder
    )
    assert answer.status == 2
    assert "--contrast" in answer.err


@pytest.mark.long
def test_without_a_pattern_every_file_is_a_subject(folder: Path, run: Run, tmp_path: Path) -> None:
    files = [folder / "s1_A.csv", folder / "s2_A.csv"]
    answer = run("analyse", *files, "--model", "single,gain", *ALONE, "--out", tmp_path)
    assert answer.status == 0, answer.err
    rows = table(tmp_path / "models.csv")
    assert [(Path(r["file"]).name, r["model"]) for r in rows if r["chosen"] == "yes"] == [
        ("s1_A.csv", "single"),
        ("s2_A.csv", "single"),
    ]
    # Models that were named are all fitted.
    assert {r["model"] for r in table(tmp_path / "estimates.csv")} == {"", "single", "gain"}
    assert table(tmp_path / "contrasts.csv") == []


def test_one_recording_as_two_subjects_is_named(small: Path, run: Run) -> None:
    files = small_files(small)[:3]
    assert run("check", *files, "--json", small / "check.json").status == 0
    entries = json.loads((small / "check.json").read_text("utf-8"))
    assert ["copied-run" in entry["codes"] for entry in entries] == [True, False, True]
