"""Every command that README and the page of commands show, run in the order they show it."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from test_docs import command_lines, commands

import pilotid

ROOT = Path(__file__).parent.parent
#: What makes a command quick: fewer simulations by one method, where the command has the option.
FEW = ("--replications", "2")
#: What other tests run: a cluster, and published recordings that are not in the project.
ELSEWHERE = ("--scheduler", "::", "--people", "--estimates", "paper")
MINE = '''
from pilotid import SCENARIOS as KNOWN
from pilotid.methods import MLEWhite
from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class Mine(MLEWhite):
    """A method of one's own."""

    order: int = 2
    name: ClassVar[str] = "mine"


SCENARIOS = KNOWN["single"]
'''


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the commands read, but for what those before them wrote."""
    place = tmp_path_factory.mktemp("commands")
    (place / "data").mkdir()
    pilot = replace(pilotid.SCENARIOS["single"], runs=2)
    for number, name in enumerate(("subj1_A", "subj1_B", "subj2_A", "subj2_B")):
        recording = pilotid.simulate(pilot, np.random.default_rng(number))
        pilotid.save_recording(recording, place / "data" / f"{name}.mat")
    for number, name in enumerate(product((1, 2), (1, 2))):
        recording = pilotid.simulate(replace(pilot, runs=1), np.random.default_rng(number))
        pilotid.save_recording(recording, place / "data" / "s{}_A_{}.csv".format(*name))
    for number, name in enumerate("abc"):
        pilotid.save_recording(pilotid.simulate("nominal", number), place / f"{name}.csv")
    run(place, ["simulate", "nominal", "--out", "run.csv"])
    recording = pilotid.load_recording(place / "run.csv")
    own = {name: getattr(recording, name).T for name in ("x", "ft", "fd")}
    turned = {"t": recording.time, "err": recording.e.T, "stick": -recording.u.T}
    scipy.io.savemat(place / "subject.mat", {**own, **turned})
    (place / "mine.py").write_text(MINE)
    words = ["compare", "--scenario", "single", "--method", "mle,mle-white", *FEW]
    for name in ("reference", "before"):
        run(place, [*words, "--out", f"results/{name}"])
    shutil.copytree(place / "results/before", place / "results/after")
    return place


def run(place: Path, words: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", "from pilotid.cli import start; start()", *words],
        cwd=place,
        capture_output=True,
        text=True,
        timeout=560,
    )
    assert done.returncode == 0, f"{shlex.join(words)}: {done.stderr[-2000:]}"


@pytest.mark.long
@pytest.mark.parametrize("page", ["README.md", "docs/guide/commands.md"])
def test_commands_run(page: str, folder: Path) -> None:
    for line in command_lines((ROOT / page).read_text("utf-8")):
        _, name, *words = shlex.split(line)
        if any(part in line for part in ELSEWHERE):
            continue
        options = {option for p in commands()[name].params for option in p.opts}
        if "--replications" in options and name != "analyse":
            words = [w for n, w in enumerate(words) if not {w, words[n - 1]} & {"--replications"}]
            words += FEW
            if "--method" in options and "--method" not in words:
                words += ["--method", "mle,fourier"]
        run(folder, [name, *(file for word in words for file in expanded(word, folder))])


def expanded(word: str, place: Path) -> list[str]:
    """A word, or the files that a shell would put in its place."""
    if "*" not in word or " " in word:
        return [word]
    return sorted(file.relative_to(place).as_posix() for file in place.glob(word)) or [word]
