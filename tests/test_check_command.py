"""`pilotid check`: what was understood of recordings, what is wrong, what methods can do."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import Run, strict

import pilotid
from pilotid.datasets import SCENARIOS, simulate
from pilotid.methods import methods
from pilotid.recordings.checks import remarks
from pilotid.recordings.files import detrended, load_recording, save_recording
from pilotid.recordings.recording import Recording, joined
from pilotid.recordings.understood import understood
from pilotid.support.disk import strict_json
from pilotid.support.remarks import codes_of
from pilotid.support.types import InputError

pytestmark = [pytest.mark.numerical, pytest.mark.long]

NOMINAL: Recording = simulate(SCENARIOS["nominal"], np.random.default_rng(4))
OTHER: Recording = simulate(SCENARIOS["nominal"], np.random.default_rng(5))


def written(recording: Recording, path: Path) -> Path:
    save_recording(recording, path)
    return path


def test_what_was_understood_is_told(run: Run, tmp_path: Path) -> None:
    printed = run("check", written(NOMINAL, tmp_path / "F.csv"))
    assert printed.status == 0, printed.err
    assert "1 run of 81.92 s at 50 Hz after 8 s of run-in" in printed.out
    assert "ft: 12 lines given, 6 to 213 times 0.0767 rad/s (0.46 to 16.3 rad/s)" in printed.out
    assert "fd: 12 lines given, 5 to 211 times" in printed.out
    assert "all of the window is scored" in printed.out
    assert "nothing is wrong with the signals" in printed.out
    told = "pilot: no sign that Kvis and tlead and Kvest of the model multi change during the recor"
    assert told in printed.out
    assert "model multi: " in printed.out


def test_json_has_everything_and_keeps_the_names(run: Run, tmp_path: Path) -> None:
    wrong = replace(OTHER, u=-OTHER.u)
    one, two = written(NOMINAL, tmp_path / "F.csv"), written(wrong, tmp_path / "G.mat")
    printed = run("check", one, two, "--json", "-", "--model", "single")
    assert printed.status == 0
    first, second = strict(printed.out)
    assert set(first) == {"recording", "understood", "remarks", "codes", "methods"}
    assert first["recording"]["lines"]["ft"][0] == 6
    assert first["remarks"] == first["recording"]["remarks"] == []
    assert first["methods"] == {"single": dict.fromkeys(methods(), "yes")}
    facts = first["understood"]
    assert (facts["runs"], facts["rate"], facts["duration"], facts["run_in"]) == (1, 50, 81.92, 8)
    assert [s["origin"] for s in facts["signals"]] == ["e", "u", "x", "ft", "fd"]
    assert facts["unscored"] == 0.0
    assert facts["constancy"]["keys"] == ["Kvis", "tlead", "Kvest"]
    assert not facts["constancy"]["changes"]
    (remark,) = second["remarks"]
    assert second["codes"] == second["recording"]["codes"] == ["wrong-sign"]
    assert remark.endswith("flip with --map u=-u")


def test_python_says_what_the_command_says(run: Run, tmp_path: Path) -> None:
    file = written(replace(NOMINAL, u=-NOMINAL.u), tmp_path / "F.csv")
    found = pilotid.check(load_recording(file), models=["single"], element="4/s^2")
    options = ("check", file, "--model", "single", "--element", "4/s^2")
    assert [(r.code, r.grade) for r in found.remarks] == [("wrong-sign", "wrong")]
    assert f"{found}\n" == run(*options).out
    printed = strict(run(*options, "--json", "-").out)
    told = json.loads(strict_json(found.to_dict()))
    for entry in (told, printed):  # its numbers are those of a search, and end in rounding
        entry["understood"]["constancy"] = list(entry["understood"]["constancy"])
    assert told == printed


def test_its_advice_mends_the_recording(run: Run, tmp_path: Path) -> None:
    file = written(replace(NOMINAL, u=-NOMINAL.u), tmp_path / "F.csv")
    assert "nothing is wrong" in run("check", file, "--map", "u=-u").out


def test_fit_says_the_same(run: Run, tmp_path: Path) -> None:
    file = written(replace(NOMINAL, u=-NOMINAL.u), tmp_path / "F.csv")
    printed = run("fit", file, "--model", "multi", "--method", "fourier")
    assert "recording: u has the wrong sign: x answers to fd - u" in printed.out


def test_in_brief_a_file_is_a_line(run: Run, tmp_path: Path) -> None:
    good = written(NOMINAL, tmp_path / "good.csv")
    bad = written(replace(OTHER, u=-OTHER.u), tmp_path / "bad.csv")
    answer = run("check", "--brief", good, bad)
    assert answer.status == 0, answer.err
    lines = " ".join(answer.out.split())
    assert lines.count("81.92 s") == 2
    first, rest = lines.split("bad.csv: ")
    assert first.split("good.csv: ")[1].split("; ")[1].split()[0] == "ok"
    assert "wrong: wrong-sign" in rest
    assert "2 recordings, 1 without" in rest
    assert "wrong-sign (wrong) 1" in rest
    assert "recordings" not in run("check", "--brief", good).out


def test_one_bad_file_does_not_cost_the_others(run: Run, tmp_path: Path) -> None:
    (tmp_path / "bad.csv").write_text("a,b\n1,2\n")
    printed = run("check", tmp_path / "bad.csv", written(NOMINAL, tmp_path / "F.csv"))
    assert printed.status == 2
    assert "nothing is wrong with the signals" in printed.out
    assert "bad.csv: line 1 has no columns 't', 'e', 'u', 'x', only a, b" in printed.err
    assert len(printed.err.splitlines()) == 1


def test_without_x_models_of_motion_are_objected_to(run: Run, tmp_path: Path) -> None:
    recording = replace(NOMINAL, ft=None, lines={})
    text = Path(written(recording, tmp_path / "F.csv")).read_text().replace(",x,", ",other,", 1)
    (tmp_path / "F.csv").write_text(text)
    (tmp_path / "F.json").unlink()
    printed = run("check", tmp_path / "F.csv")
    assert "no x: models with a channel on x cannot be fitted" in printed.out
    assert "x is not recorded, so that the vestibular channel has no input" in printed.out
    assert "mle" in printed.out.partition("model single: ")[2].partition(" can fit it")[0]
    fitted = run("fit", tmp_path / "F.csv", "--method", "mle-white")
    assert "mle-white: converged" in fitted.out


def test_what_is_not_scored_is_told_and_can_be_set(run: Run, tmp_path: Path) -> None:
    cut = slice(NOMINAL.run_in, None)
    signals = {name: getattr(NOMINAL, name)[:, cut] for name in NOMINAL.signals}
    file = written(replace(NOMINAL, run_in=0, **signals), tmp_path / "F.csv")
    assert "do not score the first 3 s of the window" in run("check", file).out
    assert "do not score the first 5 s" in run("check", file, "--lead-in", 5).out
    assert "all of the window is scored" in run("check", file, "--lead-in", 0).out
    short, long = (
        strict(run("fit", file, "--method", "mle-white", "--lead-in", s, "--json", "-").out)
        for s in (0, 20)
    )
    errors = [fit["estimates"][0]["parameters"]["tdvis"]["std_error"] for fit in (short, long)]
    assert errors[1] > errors[0]  # a quarter less is scored
    assert run("check", file, "--lead-in", -1).status == 2


def test_files_without_time_take_an_interval(run: Run, tmp_path: Path) -> None:
    written(NOMINAL, tmp_path / "F.csv")
    lines = (tmp_path / "F.csv").read_text().splitlines()
    (tmp_path / "G.csv").write_text("\n".join(line.partition(",")[2] for line in lines))
    assert "--dt 0.01" in run("check", tmp_path / "G.csv").err
    # The forcing functions come again after 81.92 s: the 8 s before are run-in, as they were.
    said = run("check", tmp_path / "G.csv", "--dt", 0.02).out
    assert "1 run of 81.92 s at 50 Hz after 8 s of run-in" in said
    assert "--dt 50: must be" in run("check", tmp_path / "G.csv", "--dt", 50).err


def test_a_straight_line_is_taken_out_and_said(run: Run, tmp_path: Path) -> None:
    ramp = replace(NOMINAL, u=NOMINAL.u + 0.02 * NOMINAL.time + 1.0)
    file = written(ramp, tmp_path / "F.csv")
    assert "u drifts" in run("check", file).out
    printed = run("check", file, "--detrend").out
    assert "recording: a straight line was taken out of u, which gained" in printed
    assert "u drifts" not in printed
    alike, plain = detrended(ramp), detrended(NOMINAL)
    np.testing.assert_allclose(alike.u, plain.u, atol=1e-9)
    window = plain.window(plain.u)[0]
    assert abs(window.mean()) < 1e-12
    assert abs(np.polyfit(np.arange(window.size), window, 1)[0]) < 1e-12


def test_an_element_that_is_not_the_one_seen_is_named(run: Run, tmp_path: Path) -> None:
    file = written(replace(NOMINAL, controlled_element=""), tmp_path / "F.csv")
    printed = run("check", file, "--element", "4/s^2").out
    assert "nothing is wrong" in printed
    assert "controlled element: 4/s^2 (given)" in printed
    assert (
        "the controlled element given is 15/s^2, but"
        in run("check", file, "--element", "15/s^2").out
    )
    facts = strict(run("check", file, "--json", "-").out)["understood"]
    assert facts["element"].endswith("(from the signals)")


def test_runs_with_other_units_are_not_of_one_condition() -> None:
    again = simulate(SCENARIOS["nominal"], np.random.default_rng(5))
    one, other = (replace(r, units={"x": unit}) for r, unit in ((NOMINAL, "deg"), (again, "rad")))
    with pytest.raises(InputError, match=r"unit of x \(rad\) differs"):
        joined([one, other])


def test_units_of_a_file_must_agree() -> None:
    told = remarks(replace(NOMINAL, units={"e": "deg", "x": "rad", "u": "V"}))
    assert told == (
        "the file gives e in deg, x in rad; e = ft - x takes one unit: convert, or correct what "
        "it says",
    )


def test_a_control_that_rests_is_mentioned_and_no_fault() -> None:
    u = NOMINAL.u.copy()
    u[:, NOMINAL.run_in :: 50] = 0.0
    u[:, NOMINAL.run_in : NOMINAL.run_in + 1024] = 0.0
    assert understood(replace(NOMINAL, u=u)).rest == pytest.approx(0.25, abs=0.01)
    assert understood(NOMINAL).rest == 0.0


def test_posteriors_of_several_files_go_to_folders_of_their_own(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []
    monkeypatch.setattr(
        "pilotid.cli.commands.infer", lambda recording, *_, **k: seen.append(k["folder"])
    )
    files = [written(NOMINAL, tmp_path / f"{name}.csv") for name in ("F", "G")]
    (tmp_path / "bad.csv").write_text("")
    out = tmp_path / "out"
    printed = run("posterior", files[0], tmp_path / "bad.csv", files[1], "--out", out)
    assert printed.status == 2
    assert "bad.csv: line 1 must be a header row" in printed.err
    assert seen == [out / "F", out / "G"]
    assert all(folder.is_dir() for folder in seen)
    (tmp_path / "other").mkdir()
    same = written(NOMINAL, tmp_path / "other" / "F.csv")
    assert "rename one of the files" in run("posterior", files[0], same, "--out", out).err


def element_changed(file: Path) -> bool:
    """Whether the controlled element of a recording of people changed, in its own axis."""
    changed = {"roll": ("C3", "C5", "C6", "C8"), "pitch": ("C4", "C5", "C7", "C8")}
    *_, condition, axis = ("", *file.stem.split("_"))
    return file.parent.name == "adaptation" and condition in changed[axis]


#: x stands still for a sample or two in these, and jumps to where it should be.
LOST = ("pilot7_C5_pitch", "pilot7_C8_roll")


def test_measured_recordings_have_no_remarks_but_of_an_element_that_changed(measured: Path) -> None:
    files = [*sorted(measured.glob("*/*.mat"))[::7], *measured.glob("rollpitch/pilot*run1*.csv")]
    for file in files:
        recording = load_recording(file)
        told = remarks(recording)
        expected = {"element-varies"} if element_changed(file) else set()
        if file.stem in LOST:
            expected |= {"lost-samples"}
        assert set(codes_of(told)) == expected, file.name
        facts = understood(recording)
        assert [f.name for f in facts.forcing] == [
            n for n in ("ft", "fd") if n in recording.signals
        ]
        assert all(len(f.lines) == 10 for f in facts.forcing), file.name
        assert "wrong-sign" in codes_of(remarks(replace(recording, u=-recording.u))), file.name


def test_a_pilot_who_changes_is_mentioned(run: Run, tmp_path: Path) -> None:
    slow = simulate(SCENARIOS["adapting-slow"], np.random.default_rng(4))
    file = written(slow, tmp_path / "F.csv")
    told = "pilot: Kvis and tlead of the model single change during the recording, most about t = "
    assert told in run("check", file).out
    assert strict(run("check", file, "--json", "-").out)["understood"]["constancy"]["changes"]
