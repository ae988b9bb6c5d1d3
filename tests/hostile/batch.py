"""Runs commands in this process, many one after the other, and says what became of each.

    python batch.py stores|commands SEED COUNT FOLDER

writes a line of JSON for each: what was tried, the status, what was wrong, the pages; and a last
one with the memory that all of it took.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import shutil
import signal
import sqlite3
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
from stores import changed, finish

from pilotid.cli.main import main
from pilotid.datasets import scenario_named, simulate
from pilotid.recordings.files import save_recording
from pilotid.support.store import STORE

LIMIT = 120  # s a command, on a busy machine
SENTENCE = 1500  # characters

EVIL: list[Any] = [
    "<script>document.title='PWNED'</script>", "<img src=http://127.0.0.1:PORT/x>",
    "[x](javascript:document.title='PWNED')", "![x](http://127.0.0.1:PORT/y)",
    "</title><svg onload=\"document.title='PWNED'\">", r"$\frac{$", "\x1b]0;PWNED\x07\x1b[31m",
    "\x00\x01", "a\udcffb", "\u202eabc", "../../../../tmp/x", "a" * 70000, "",
    "x\n\n# y\n| z |", "{{ 7*7 }}", "%s%n", "=cmd|' /C calc'!A0", "'; DROP TABLE rows; --",
    None, True, -1, 2**63, 10**400, 1e308, -1e308, 5e-324, float("nan"), [], {}, [[[]]],
    {"class": "os.system"}, {"__reduce__": "x"},
]  # fmt: skip


def evil(rng: np.random.Generator, like: Any = None) -> Any:
    """Something evil, mostly of the same type, which is looked at less closely."""
    alike = [each for each in EVIL if type(each) is type(like)]
    some = alike if alike and rng.random() < 0.85 else EVIL
    return some[rng.integers(len(some))]


def spoiled(value: Any, rng: np.random.Generator) -> Any:
    """Plain objects, in which a leaf, a part or all of them was exchanged for something evil."""
    if isinstance(value, list | dict) and value and rng.random() < 0.93:
        keys = list(value) if isinstance(value, dict) else list(range(len(value)))
        key = keys[rng.integers(len(keys))]
        copy = dict(value) if isinstance(value, dict) else list(value)
        if rng.random() < 0.05:
            del copy[key]
        elif isinstance(value, dict) and rng.random() < 0.1:
            copy[str(evil(rng))] = copy.pop(key)
        else:
            copy[key] = spoiled(value[key], rng)
        return copy
    if isinstance(value, str) and value[:1] in ("{", "[") and rng.random() < 0.9:
        with contextlib.suppress(ValueError):
            return json.dumps(spoiled(json.loads(value), rng))
    return evil(rng, value)


def spoil_rows(path: Path, rng: np.random.Generator) -> None:
    """Rows of a store."""
    with closing(sqlite3.connect(path)) as base:
        rows = base.execute(
            "SELECT rowid, scenario = '', method = '', content FROM rows"
        ).fetchall()
        kinds = sorted({row[1:3] for row in rows})
        kind = kinds[rng.integers(len(kinds))]
        own = [row for row in rows if row[1:3] == kind]
        for number, *_, content in own if rng.random() < 0.5 else [own[rng.integers(len(own))]]:
            new = json.dumps(spoiled(json.loads(content), rng))
            base.execute("UPDATE rows SET content=? WHERE rowid=?", (new, number))
        base.commit()


def compute(path: Path, rng: np.random.Generator) -> None:
    """A store with a schema that computes."""
    endless = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x FROM c) SELECT x FROM c"
    statements = [
        f"ALTER TABLE rows RENAME TO r; CREATE VIEW rows AS {endless}",
        f"CREATE VIEW counts2 AS {endless}",
        "CREATE TABLE t (a, CHECK (length(zeroblob(900000000)) > 0)); INSERT INTO t VALUES (1)",
        "CREATE TABLE t (a, b AS (hex(zeroblob(400000000))))",
        f"PRAGMA user_version = {int(rng.integers(-5, 99))}",
    ]
    with closing(sqlite3.connect(path)) as base, contextlib.suppress(sqlite3.Error):
        base.executescript(statements[rng.integers(len(statements))])


def shake(path: Path, rng: np.random.Generator) -> None:
    path.write_bytes(changed(path.read_bytes(), rng))


#: What is done to a file, and how often.
DAMAGE: list[tuple[str, Callable[[Path, np.random.Generator], None], float]] = [
    (STORE, spoil_rows, 0.8), (STORE, shake, 0.14), (STORE, compute, 0.06),
]  # fmt: skip


def stores(seed: int, count: int, folder: Path) -> Iterator[tuple[str, list[str], Path]]:
    """Damaged and malicious stores, each with the command that reads it."""
    (folder / "whole").mkdir()
    finish(folder / "whole", 2).close()
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        name, damage, _ = DAMAGE[rng.choice(len(DAMAGE), p=[share for *_, share in DAMAGE])]
        place = folder / f"in{number}"
        place.mkdir()
        shutil.copyfile(folder / "whole" / name, place / name)
        damage(place / name, rng)
        out = str(folder / f"out{number}")
        command = ["report", str(place), "--out", out]
        if rng.random() < 0.2:
            command = ["compare-studies", str(place), str(folder / "whole")]
        yield f"{damage.__name__} {number}", command, place


#: Words of commands that must be refused, or cost little.
OPTIONS: dict[str, list[str]] = {
    "fit s.csv --model single --method mle-white": [
        "--lead-in", "--dt", "--seed", "--runs", "--span", "--fix", "--start", "--element",
        "--map", "--json", "--report", "--truth", "--method", "--model",
    ],
    "check s.csv --brief": ["--lead-in", "--dt", "--runs", "--span", "--element", "--map"],
    "simulate single --out new.csv": ["--seed", "--runs", "--like"],
    "design nominal --out d": ["--limit", "--minimise", "--from"],
    "compare --out c": [
        "--replications", "--workers", "--time-limit", "--seed", "--scenario",
        "--method", "--profile", "--like",
    ],
    "report whole --out r": ["--wrong"],
    "list": ["--x"],
}  # fmt: skip
VALUES = [
    "-1", "0", "1e308", "-1e308", "nan", "inf", "1e23", "99999999999999999999", "", " ", "x",
    "a=b", "a=1e999", "tdvis=nan", "Kvis=0", "1-0", "5-1", "0:0", "9:1", "1e308:2e308",
    "u=u", "u=-x,u=e", "e=0*e", "mle(band=0)", "arx(memory=-1)", "mle(nothing=1)", "(((",
    "file.py:X", "os:system", "s.csv", "s.json", "whole", "whole/study.sqlite", "nowhere/x.json",
    "/dev/null",
    "pipe", "../..", "x" * 5000, "$(touch PWNED)", "`touch PWNED`", "a\nb", "\u202e", "1/s^99",
    "1/0", "(s", "e=1e999", "tlead +15%", "tdvest=0%", "tdvest=3%", "[" * 2000,
]  # fmt: skip


def commands(seed: int, count: int, folder: Path) -> Iterator[tuple[str, list[str], Path]]:
    """Command lines with one or two options that have no such value."""
    (folder / "in").mkdir()
    recording = simulate(scenario_named("single"), np.random.default_rng(1))
    save_recording(recording, folder / "in" / "s.csv")
    (folder / "in" / "whole").mkdir()
    finish(folder / "in" / "whole", 1).close()
    os.chdir(folder / "in")
    os.mkfifo("pipe")
    for number in range(count):
        rng = np.random.default_rng([seed, 1, number])
        starts = [*OPTIONS, *list(OPTIONS)[:1] * 4, *list(OPTIONS)[3:4] * 3]
        start = starts[rng.integers(len(starts))]
        given = start.replace("--out ", f"--out {folder}/out{number}").split()
        if start.startswith("compare --out"):  # what is not refused must cost little
            given += ["--scenario", "single", "--method", "nothing"]
        for _ in range(int(rng.integers(1, 3))):
            option = OPTIONS[start][rng.integers(len(OPTIONS[start]))]
            value = VALUES[rng.integers(len(VALUES))]
            writes = option in ("--json", "--csv", "--report")
            if writes and value == "pipe":  # which would wait for a reader, as pipes do
                continue
            given += [option, f"{folder}/x" if writes and value == "x" else value]
        yield " ".join(given)[:300], given, folder / "in"


def digests(place: Path) -> dict[str, str]:
    files = (path for path in place.rglob("*") if path.is_file())
    return {str(path): sha256(path.read_bytes()).hexdigest() for path in files}


def attempt(command: list[str], place: Path, before: dict[str, str]) -> dict[str, Any]:
    """What a command did: status, what is wrong with that, seconds."""
    begin = time.monotonic()
    out, err = io.StringIO(), io.StringIO()

    def late(*_: object) -> None:
        raise TimeoutError(f"it takes longer than {LIMIT} s")

    signal.signal(signal.SIGALRM, late)
    signal.alarm(LIMIT)
    wrong = []
    status: object = None
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main(command)
    except SystemExit as end:
        status = end.code or 0
    except BaseException as error:
        wrong.append(f"{type(error).__name__}: {error}"[:300])
    signal.alarm(0)
    told, said = err.getvalue(), out.getvalue()
    if status not in (0, 2):
        wrong.append(f"status {status}")
    if status == 2 and (len(told.splitlines()) != 1 or not told.startswith("pilotid: ")):
        wrong.append(f"not one sentence: {told[:300]}")
    if "Traceback" in told + said or any(sign in told + said for sign in "\x1b\x00\x07\u202e"):
        wrong.append(f"traceback or signs that act: {told[-300:]!r} {said[-100:]!r}")
    after = digests(place)
    if any(after.get(path) != own for path, own in before.items()):
        wrong.append("an input changed")
    return {"status": status, "wrong": wrong, "seconds": time.monotonic() - begin}


def run() -> None:
    kind, seed, count, folder = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4])
    tried = {"stores": stores, "commands": commands}[kind](seed, count, folder)
    inputs: dict[Path, dict[str, str]] = {}
    for what, command, place in tried:
        before = inputs.setdefault(place, digests(place))
        print(json.dumps({"what": what, **attempt(command, place, before)}), flush=True)
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(json.dumps({"what": "memory", "megabytes": used}))


if __name__ == "__main__":
    run()
