"""The command line: what it prints and writes, and how it refuses bad input."""

from __future__ import annotations

import csv
import json
import re
import signal
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from helpers import Answer, Run, leading_recording, strict
from scipy.io import savemat

import pilotid
from pilotid.cli.main import main
from pilotid.datasets import CATALOGUE
from pilotid.methods import METHODS
from pilotid.model.catalogue import MODELS
from pilotid.recording.files import load_recording, save_recording
from pilotid.support.remarks import CODES

# The columns that others script against.
ESTIMATES_HEAD = (
    "scenario,method,replication,outcome,parameter,truth,value,std_error,lower_95,upper_95,seconds,"
    "crlb,determined"
)
SUMMARY_HEAD = (
    "scenario,method,parameter,n,failures,truth,bias,bias_se,bias_percent,std,rmse,crlb,"
    "mean_std_error,coverage_95,posterior_std,loss,loss_lower,loss_upper"
)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated recording of the multi-channel pilot, beside its sidecar and truth."""
    path = tmp_path_factory.mktemp("simulated") / "run.csv"
    with pytest.raises(SystemExit) as end:
        main(["simulate", "nominal", "--out", str(path), "--seed", "3"])
    assert not end.value.code
    return path


def refused(answer: Answer, *words: str) -> None:
    """One sentence on standard error that holds these words, nothing else, and status 2."""
    assert answer.status == 2
    assert answer.out == ""
    assert len(answer.err.splitlines()) == 1, answer.err
    assert "Traceback" not in answer.err
    for word in words:
        assert word in answer.err, (word, answer.err)


# ------------------------------------------------------------- models without their signals


@pytest.mark.parametrize(
    ("columns", "options", "words"),
    [
        ("t,e,u", ("multi",), "acts on what is not recorded (x)"),
        ("t,e,u", ("preview",), "acts on what is not recorded (ft, x)"),
        ("t,e,u,x,ft", ("look-ahead", "--fix", "tlook=0..60"), "looks up to 60 s ahead"),
    ],
)
def test_a_model_whose_signals_are_not_recorded_is_refused_with_their_names(
    run: Run, simulated: Path, tmp_path: Path, columns: str, options: tuple[str, ...], words: str
) -> None:
    file = tmp_path / "some.csv"
    table = list(csv.DictReader(simulated.read_text().splitlines()))
    with file.open("w", newline="") as stream:
        rows = csv.DictWriter(stream, columns.split(","), extrasaction="ignore")
        rows.writeheader()
        rows.writerows(table)
    refused(run("fit", file, "--model", *options), "some.csv", words)
    if words.endswith("(x)"):  # other recordings are fitted all the same
        answer = run("fit", file, simulated, "--model", "multi", "--method", "mle-white")
        assert answer.status == 2
        assert words in answer.err
        assert "model multi" in answer.out


# ------------------------------------------------------------------------------------- list


def test_the_installed_command_runs(run: Run) -> None:
    assert run("--version").out == f"pilotid {version('pilotid')}\n"
    assert pilotid.__version__ == version("pilotid")
    command = Path(sys.executable).with_name("pilotid")
    done = subprocess.run([command, "list"], capture_output=True, text=True, check=True, timeout=60)
    named = re.findall(r"(?m)^  (\S+) ", done.stdout)
    assert named == [*MODELS, *METHODS, *CATALOGUE]
    bad = subprocess.run([command, "fit", "x.csv"], capture_output=True, text=True, timeout=60)
    assert (bad.returncode, bad.stdout) == (2, "")
    assert bad.stderr.startswith("pilotid: x.csv: ")


# --------------------------------------------------------------------------- simulate and fit


def test_simulate_writes_recording_sidecar_and_truth(simulated: Path) -> None:
    recording = load_recording(simulated)
    assert (recording.runs, recording.samples, recording.run_in) == (1, 4096, 400)
    assert json.loads(simulated.with_suffix(".json").read_text())["lines"]["ft"][:2] == [6, 9]
    truth = json.loads(simulated.with_suffix(".truth.json").read_text())
    assert truth["scenario"] == "nominal"
    assert truth["seed"] == 3
    assert truth["parameters"]["tlead"] == {"value": 2.93, "unit": "s"}
    assert truth["controlled_element"]["numerator"] == [4.0]
    # FACTS of the paper's pilot at K = 4: crossover and phase margin of both loops.
    assert truth["loops"]["target"]["crossover"] == pytest.approx(2.38, abs=0.02)
    assert truth["loops"]["disturbance"]["phase_margin"] == pytest.approx(27.0, abs=1.0)


def test_simulate_draws_a_pilot_of_a_population(run: Run, tmp_path: Path) -> None:
    models = set()
    for seed in range(4):
        out = tmp_path / f"{seed}.csv"
        answer = run("simulate", "population-usual", "--out", out, "--seed", seed)
        assert answer.status == 0, answer.err
        truth = json.loads(out.with_suffix(".truth.json").read_text())
        assert truth["scenario"] == "population-usual"
        assert f"(model {truth['model']})" in answer.out
        assert load_recording(out).runs == truth["runs"]
        models.add((truth["model"], truth["parameters"]["fnm"]["value"]))
    assert len(models) == 4


def test_fit_finds_the_truth_and_writes_it_as_agreed(run: Run, simulated: Path) -> None:
    answer = run("fit", simulated, "--model", "multi", "--method", "mle-white", "--json", "-")
    result = strict(answer.out)
    assert set(result) == {"recording", "model", "estimates"}
    assert result["model"] == "multi"
    assert result["recording"]["runs"] == 1
    (estimate,) = result["estimates"]
    assert estimate["method"] == "mle-white"
    assert (estimate["outcome"], estimate["message"]) == ("converged", "converged")
    assert list(estimate["parameters"]) == list(MODELS["multi"].keys)
    truth = json.loads(simulated.with_suffix(".truth.json").read_text())["parameters"]
    for key, entry in estimate["parameters"].items():
        assert set(entry) == {"value", "std_error", "interval_95", "unit", "determined"}
        assert entry["unit"] == truth[key]["unit"]
        low, high = entry["interval_95"]
        assert low < entry["value"] < high
        # A white residual is biased here, by up to a quarter.
        assert entry["value"] == pytest.approx(truth[key]["value"], rel=0.5)
    assert np.array(estimate["correlation"]).shape == (7, 7)
    assert 60.0 < estimate["vaf"] < 95.0
    assert estimate["seconds"] > 0.0
    product = estimate["derived"]["Kvis*tlead"]
    gain, lead = estimate["parameters"]["Kvis"], estimate["parameters"]["tlead"]
    assert product["value"] == pytest.approx(gain["value"] * lead["value"])
    # Gain and lead are correlated, so that their product is known better than either.
    assert product["std_error"] / product["value"] < 0.6 * gain["std_error"] / gain["value"]


def test_fit_tells_a_failure_and_stays_at_status_0(run: Run, tmp_path: Path) -> None:
    save_recording(leading_recording(), tmp_path / "lead.csv")
    arguments = ("fit", tmp_path / "lead.csv", "--model", "gain", "--method", "mmle3")
    answer = run(*arguments, "--json", "-")
    assert answer.status == 0
    (estimate,) = strict(answer.out)["estimates"]
    assert estimate["outcome"] == "negative-delay"
    assert estimate["message"] == "failed: a time delay was driven negative"
    assert estimate["parameters"]["Kvis"]["value"] is None
    assert estimate["vaf"] is None
    table = run(*arguments)
    assert table.status == 0
    assert "mmle3: failed: a time delay was driven negative" in table.out


def test_without_a_model_the_recording_chooses(run: Run, simulated: Path) -> None:
    result = strict(run("fit", simulated, "--json", "-").out)
    assert result["model"] == "multi"
    assert len(result["estimates"]) == 1
    assert result["choice"].startswith("multi was chosen among")
    misfits = {entry["model"]: entry["chi_squared"] for entry in result["models"]}
    assert misfits["multi"] < misfits["single"]
    named = strict(run("fit", simulated, "--model", "single", "--json", "-").out)
    assert named["model"] == "single"
    assert not {"choice", "models"} & set(named)


def test_several_files_give_a_list_and_joint_gives_one(
    run: Run, simulated: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.csv"
    run("simulate", "nominal", "--out", other, "--seed", 9)
    fit = ("fit", simulated, other, "--method", "mle-white", "--json", tmp_path / "f.json")
    assert run(*fit).status == 0
    apart = strict((tmp_path / "f.json").read_text())
    assert [entry["recording"]["source"] for entry in apart] == [str(simulated), str(other)]
    assert run(*fit, "--joint").status == 0
    together = strict((tmp_path / "f.json").read_text())
    assert together["recording"]["runs"] == 2
    gains = [e["estimates"][0]["parameters"]["Kvis"] for e in (*apart, together)]
    assert gains[2]["std_error"] < min(gains[0]["std_error"], gains[1]["std_error"])


# ------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--model", "tripl"), ("unknown model 'tripl'", "single, multi")),
        (("--method", "mle-black"), ("unknown method 'mle-black'", "mle-white")),
        (("--method", "all,mle-black"), ("unknown method 'mle-black'", "mle-white")),
        (("--map", "stick"), ("SIGNAL=NAME",)),
        (("--map", "q=stick"), ("no 'stick'", "q (extra signal)")),
        (("--map", "u=stick"), ("run.csv", "'stick'")),
        (("--seed", "-1"), ("--seed",)),
        (("--seed", "many"), ("--seed",)),
        (("--sed", "1"), ("--sed", "pilotid fit --help")),
        (("--json", "none/f.json"), ("none/f.json: cannot be written",)),
        (("--report", "."), (".: cannot be written",)),
        (("--report", "r.pdf"), ("r.pdf: does not end in .html; a report is an .html file",)),
    ],
    ids=lambda value: "=".join(value) if isinstance(value, tuple) else None,
)
def test_bad_options(
    run: Run, simulated: Path, options: tuple[str, ...], words: tuple[str, ...]
) -> None:
    refused(run("fit", simulated, *options), *words)


@pytest.mark.parametrize("text", ["t,e,u,x\n", "t,e,u,x\ns,deg,deg,deg\n", "t,e,u,x\n0,1,2,3\n"])
def test_a_file_without_samples(run: Run, text: str, tmp_path: Path) -> None:
    file = tmp_path / "header.csv"
    file.write_text(text)
    refused(run("check", file), "header.csv", "at least 10 s")


def test_other_commands_refuse_too(run: Run, tmp_path: Path) -> None:
    refused(run("frobnicate"), "frobnicate")
    refused(run("fit"), "pilotid fit --help")
    refused(run("simulate", "nominale", "--out", tmp_path / "x.csv"), "'nominale'", "nominal")
    refused(run("simulate", "nominal", "--out", tmp_path / "x.txt"), "end in .csv .mat .npz; name")
    refused(run("simulate", "nominal", "--out", tmp_path / "none" / "x.csv"), "x.csv")
    refused(run("compare", "--scenario", "x", "--out", tmp_path), "'x'", "nominal")
    refused(run("compare", "--method", "x", "--out", tmp_path), "'x'", "mle-white")
    refused(run("compare", "--profile", "x", "--out", tmp_path), "'x'", "quick")
    refused(run("report", tmp_path), "study.sqlite", "pilotid compare")
    file = tmp_path / "file"
    file.touch()
    refused(run("compare", "--method", "mle-white", "--out", file), "file", "--out")


# --------------------------------------------------------------------------------- compare


@pytest.mark.long
def test_compare_gives_the_same_numbers_with_any_number_of_workers(
    run: Run, tmp_path: Path
) -> None:
    options = ("--scenario", "single", "--method", "mle-white", "--replications", 2, "--seed", 5)
    for workers in (1, 2):
        out = tmp_path / str(workers)
        answer = run("compare", *options, "--workers", workers, "--out", out)
        assert answer.status == 0, answer.err
        assert answer.out.splitlines()[-1] == f"report: {out / 'report.html'}"
    one, two = tmp_path / "1", tmp_path / "2"
    assert (one / "summary.csv").read_bytes() == (two / "summary.csv").read_bytes()
    with (one / "estimates.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert ",".join(rows[0]) == ESTIMATES_HEAD
    assert len(rows) == 2 * 5
    with (one / "summary.csv").open(newline="") as stream:
        summary = list(csv.DictReader(stream))
    assert ",".join(summary[0]) == SUMMARY_HEAD
    gain = [float(row["value"]) for row in rows if row["parameter"] == "Kvis"]
    assert float(summary[0]["bias"]) == pytest.approx(np.mean(gain) - 0.32)
    assert summary[0]["n"] == "2"
    assert float(summary[0]["crlb"]) == pytest.approx(0.1306 * 0.32, rel=1e-3)  # theory's 13.1 %

    names = ("summary.csv", "estimates.csv", "report.md", "report.html")
    before = {name: (one / name).read_bytes() for name in names}
    for name in names:
        (one / name).unlink()
    assert run("report", one).status == 0
    assert {name: (one / name).read_bytes() for name in names} == before


@pytest.mark.long
def test_compare_goes_on_where_it_stopped_and_does_not_mix(run: Run, tmp_path: Path) -> None:
    options = ("compare", "--scenario", "single", "--method", "mle-white", "--out", tmp_path)
    assert run(*options, "--replications", 1).status == 0
    answer = run(*options, "--replications", 2)
    assert "holds 1 of 2 fits already" in answer.out
    refused(run(*options, "--seed", 9), "study.sqlite", "seed", "--out")
    assert "seed" in (tmp_path / "report.md").read_text(encoding="utf-8")


OWN = """
from dataclasses import replace
from pilotid.datasets import SCENARIOS
from pilotid.methods.mle_white import MLEWhite
from pilotid.support.remarks import CODES

ONE = replace(SCENARIOS["single"], name="one", duration=30.0)
TWO = replace(ONE, name="two", runs=2)
BOTH = [ONE, TWO]

class Mine(MLEWhite):
    "Maximum likelihood of my own."
    name = "mine"
"""


@pytest.fixture
def own(tmp_path: Path) -> Path:
    file = tmp_path / "own.py"
    file.write_text(OWN)
    return file


@pytest.mark.long
def test_methods_and_scenarios_come_from_code_and_with_settings(
    run: Run, own: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    methods = f"mle-white(band=30),{own}:Mine(band=20)"
    options = ("--method", methods, "--method", "mle-white", "--replications", 1, "--out", out)
    assert run("compare", "--scenario", f"{own}:ONE,{own}:TWO,single(runs=2)", *options).status == 0
    with (out / "summary.csv").open(newline="") as stream:
        keys = {(row["scenario"], row["method"]) for row in csv.DictReader(stream)}
    labels = ("mle-white", "mle-white(band=30)", "mine(band=20)")
    assert keys == {(s, m) for s in ("one", "two", "single-runs-2") for m in labels}
    typed = f"--scenario '{own}:ONE,{own}:TWO,single(runs=2)'"
    assert typed in (out / "report.md").read_text(encoding="utf-8")


def test_fit_and_simulate_take_code_and_settings_too(run: Run, own: Path, tmp_path: Path) -> None:
    csv_file = tmp_path / "one.csv"
    assert run("simulate", f"{own}:ONE", "--out", csv_file).status == 0
    fit = ("fit", csv_file, "--json", "-", "--method")
    result = strict(run(*fit, f"arx,arx(memory=none),{own}:Mine").out)
    names = [estimate["method"] for estimate in result["estimates"]]
    assert names == ["arx", "arx(memory=none)", "mine"]
    values = [e["parameters"]["tdvis"]["value"] for e in result["estimates"]]
    assert len(set(values)) == 3
    refused(run("simulate", f"{own}:BOTH", "--out", csv_file), "is no Scenario", "name one")
    refused(run(*fit, "arx(memory=x)"), "memory=x: Input should be a valid number")
    refused(run(*fit, "arx(memory=1"), "unknown method 'arx(memory=1'")
    refused(run(*fit, f"{own}:Yours"), "holds no 'Yours'")
    refused(run(*fit, f"{own}:ONE"), "is no method")
    refused(run("compare", "--scenario", f"{own}:Mine", "--out", tmp_path), "is no Scenario")
    refused(run("compare", "--scenario", "single(run=2)", "--out", tmp_path), "'run'", "runs")


def test_a_bad_file_does_not_cost_the_others(run: Run, simulated: Path, tmp_path: Path) -> None:
    missing, out = tmp_path / "missing.csv", tmp_path / "f.json"
    options = ("--method", "mle-white", "--json", out)
    damaged = tmp_path / "damaged.mat"
    savemat(damaged, {name: np.arange(300.0)[:, None] for name in "teux"})
    damaged.write_bytes(damaged.read_bytes()[:176] + b"\0" + damaged.read_bytes()[177:])
    answer = run("fit", missing, damaged, simulated, *options)
    assert answer.status == 2
    assert [str(file) in answer.err for file in (missing, damaged)] == [True, True]
    assert strict(out.read_text())["recording"]["source"] == str(simulated)
    out.unlink()
    refused(run("fit", missing, simulated, "--joint", *options), "No such file")
    assert not out.exists()


@pytest.mark.long
@pytest.mark.parametrize("after", [0.15, 0.3, 0.6, 1.2])
def test_an_interruption_is_a_sentence_at_any_moment(simulated: Path, after: float) -> None:
    program = (sys.executable, "-c", "from pilotid.cli import start; start()", "check", simulated)
    process = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    time.sleep(after)
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=60)
    early = process.returncode == -signal.SIGINT  # Python itself was not there yet
    assert early or (process.returncode in (0, 130) and "Traceback" not in told)


def test_remarks_are_printed_and_written(run: Run, simulated: Path) -> None:
    options = ("--method", "mle-white", "--model", "multi", "--map", "e=-e")
    lines = run("fit", simulated, *options).out.splitlines()
    remark = "e is not ft - x: e has the wrong sign; flip it with --map e=e"
    assert f"wrong [wrong-sign] recording: {remark}" in lines
    result = strict(run("fit", simulated, *options, "--json", "-").out)
    assert result["recording"]["remarks"] == [remark]
    estimate = result["estimates"][0]
    told = list(zip(estimate["codes"], estimate["remarks"], strict=True))
    shown = re.findall(r"(?m)^(?:wrong|doubt) \[([\w-]+)\] mle-white: ", "\n".join(lines))
    assert shown == [code for code, _ in told if CODES[code][0] != "note"]
    notes = [code for code, _ in told if CODES[code][0] == "note"]
    (line,) = [line for line in lines if line.startswith("notes")]
    assert line.endswith(": " + ", ".join(dict.fromkeys(notes)))
    sound = strict(run("fit", simulated, "--method", "mle-white", "--json", "-").out)
    assert sound["recording"]["remarks"] == []
    assert set(sound["estimates"][0]["codes"]) == {"residual-not-white"}
