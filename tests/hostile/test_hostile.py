"""Strangers' stores, nonsense on the command line, odd surroundings and plug-ins that misbehave.

Each is made from a seed.  There must be no traceback, no status 0 with lost work, no process above
1 GB or its time, nothing that a page makes a browser do, and no input that changed.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from hashlib import sha256
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest

from pilotid.datasets import scenario_named, simulate
from pilotid.recordings.files import save_recording

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs Linux")

HERE = Path(__file__).parent
SEED = int(os.environ.get("PILOTID_HOSTILE_SEED", "1"))
MEGABYTES = 1000.0
BROWSER = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chrome"))), None)
PROGRAM = [sys.executable, "-c", "from pilotid.cli import start; start()"]


def part(few: int, many: int) -> pytest.MarkDecorator:
    """A part of the trial each day, and all of it before a release."""
    return pytest.mark.parametrize("count", [few, pytest.param(many, marks=pytest.mark.long)])


def batch(kind: str, count: int, folder: Path) -> None:
    """Run commands in one process, and assert what each left behind."""
    made = [sys.executable, str(HERE / "batch.py"), kind, str(SEED), str(count), str(folder)]
    done = subprocess.run(made, capture_output=True, text=True, timeout=60 + 12 * count)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 0, done.stderr[-2000:]
    *tried, memory = lines
    assert len(tried) == count
    assert not [one for one in tried if one["wrong"]]
    assert memory["megabytes"] < MEGABYTES


@part(16, 500)
def test_stores_and_rows_files_of_strangers(tmp_path: Path, count: int) -> None:
    batch("stores", count, tmp_path)
    pages = [*tmp_path.glob("out*/report.html"), *tmp_path.glob("out*/index.html")]
    if BROWSER is None:
        pytest.skip("no Chromium on the PATH")
    pages.sort(key=lambda page: "PWNED" not in page.read_text("utf-8"))
    browsed(pages[: 1 + count // 25], tmp_path)


def browsed(pages: list[Path], folder: Path) -> None:
    """Open pages in a browser: nothing of theirs runs, and nothing is asked of a server."""
    asked: list[str] = []

    class Listener(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)

    server = HTTPServer(("127.0.0.1", 0), Listener)
    Thread(target=server.serve_forever, daemon=True).start()
    for page in pages:
        text = page.read_text("utf-8").replace("PORT", str(server.server_port))
        page.write_text(text, encoding="utf-8")
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=1000"]
        done = subprocess.run(
            [str(BROWSER), *options, f"--user-data-dir={folder / 'profile'}", "--dump-dom",
             page.as_uri()],
            capture_output=True, text=True, timeout=120,
        )  # fmt: skip
        assert "<html" in done.stdout
        assert "<title>PWNED" not in done.stdout
    server.shutdown()
    server.server_close()
    assert not asked


@part(20, 200)
def test_command_lines(tmp_path: Path, count: int) -> None:
    batch("commands", count, tmp_path)
    assert not list(tmp_path.rglob("PWNED"))


# --------------------------------------------------------------------------- surroundings

ENVIRONMENTS: list[dict[str, str]] = [
    {}, {"MPLBACKEND": "nonsense"}, {"LANG": "C", "PYTHONUTF8": "0"}, {"PYTHONIOENCODING": "ascii"},
    {"PYTHONIOENCODING": "utf-16"}, {"HOME": "/nowhere"}, {"TMPDIR": "/nowhere"}, {"COLUMNS": "-1"},
    {"PYTHONWARNINGS": "error"}, {"PYTHONOPTIMIZE": "2"}, {"TZ": "nonsense"}, {"TERM": "dumb"},
]  # fmt: skip
#: What a shell does before; `$OUT` is where results go.
SHELLS = [
    "", "umask 777;", "exec <&-;", "exec 2>&-;", "exec >&-;", "exec >/dev/full;",
    "exec 2>/dev/full;", "ulimit -v 262144;", "ulimit -f 1;", "ulimit -n 12;",
    "mkdir gone; cd gone; rmdir ../gone;",
]  # fmt: skip
RUNS = [
    "fit $IN/s.csv --model single --method mle-white --json $OUT/f.json",
    "check $IN/s.csv --json $OUT/f.json",
    "simulate single --out $OUT/f.csv",
    "list",
]


@part(5, 40)
def test_surroundings(tmp_path: Path, count: int) -> None:
    place = tmp_path / "in"
    place.mkdir()
    save_recording(RECORDING, place / "s.csv")
    before = digests(place)
    for number in range(count):
        rng = np.random.default_rng([SEED, 2, number])
        extra = ENVIRONMENTS[rng.integers(len(ENVIRONMENTS))]
        shell, run = SHELLS[rng.integers(len(SHELLS))], RUNS[rng.integers(len(RUNS))]
        out = tmp_path / f"out{number}"
        out.mkdir()
        command = " ".join(f"'{word}'" for word in PROGRAM)
        process = subprocess.Popen(
            ["bash", "-c", f"{shell} exec {command} {run}"],
            env={**os.environ, **extra, "IN": str(place), "OUT": str(out)},
            cwd=out, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        interrupted = rng.random() < 0.25
        if interrupted:
            time.sleep(float(rng.uniform(0.3, 1.5)))
            process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=180)
        what = (extra, shell, run, interrupted, process.returncode, told)
        early = interrupted and process.returncode == -signal.SIGINT  # before Python is there
        assert process.returncode in ((0, 2, 130) if interrupted else (0, 2)) or early, what
        assert early or "Traceback" not in told, what
        if process.returncode == 0 and "$OUT" in run and "gone" not in shell:
            assert list(out.iterdir()), what
    assert digests(place) == before


# ------------------------------------------------------------------------------- plug-ins

RECORDING = simulate(scenario_named("single"), np.random.default_rng(1))


def digests(place: Path) -> dict[str, str]:
    return {str(path): sha256(path.read_bytes()).hexdigest() for path in place.iterdir()}


def plug_ins(count: int) -> Iterator[tuple[str, ...]]:
    """Everything that `hostile.Hostile` knows, then two at a time."""
    import hostile

    deeds = [how for how in hostile.HOWS if how not in ("hang", "eat")]
    order = np.random.default_rng([SEED, 3])
    every = [(how,) for how in order.permutation(deeds)]
    while len(every) < count:
        every.append(tuple(order.choice(deeds, 2, replace=False)))
    yield from every[:count]


@part(3, 40)
def test_a_plug_in_costs_its_own_row_alone(tmp_path: Path, count: int) -> None:
    save_recording(RECORDING, tmp_path / "s.csv")
    clean: dict[str, Any] = {}
    for number, hows in enumerate([(), *plug_ins(count)]):
        methods = [f"{HERE.parent / 'hostile.py'}:Hostile(how={how})" for how in hows]
        given = ["fit", "s.csv", "--model", "single", "--method", ",".join([*methods, "mle-white"])]
        done = subprocess.run(
            [*PROGRAM, *given, "--json", "-"], cwd=tmp_path, capture_output=True, text=True,
            timeout=300,
        )  # fmt: skip
        assert done.returncode == 0, (hows, done.stderr)
        assert "Traceback" not in done.stderr, (hows, done.stderr)
        estimates = json.loads(done.stdout)["estimates"]
        assert len(estimates) == len(hows) + 1
        clean = estimates[-1]["parameters"] if number == 0 else clean
        assert estimates[-1]["parameters"] == clean, hows
