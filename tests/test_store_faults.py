"""What may happen to a store: changed bytes, a full disk, no rights, deaths, two at once."""

from __future__ import annotations

import shutil
import sqlite3
import subprocess
import sys
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
import pytest
from helpers import Answer, Run
from stores import Content, changed, content_of, finish

from pilotid.study.table import Fit, Store
from pilotid.support.store import STORE
from pilotid.support.types import InputError

HERE = str(Path(__file__).parent)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    finish(folder).close()
    return folder


@pytest.fixture(scope="module")
def whole(finished: Path) -> Content:
    with Store(finished) as store:
        return content_of(store)


def copied(finished: Path, folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    shutil.copy(finished / STORE, folder / STORE)
    return folder


def refused(answer: Answer, *words: str) -> None:
    """One sentence on standard error that has these words, and status 2."""
    assert answer.status == 2, answer
    assert len(answer.err.splitlines()) == 1, answer.err
    for word in words:
        assert word in answer.err


# -------------------------------------------------------------------------- changed bytes


@pytest.mark.parametrize("command", ["report", "compare"])
def test_commands_refuse_a_damaged_store_and_leave_it_as_it_is(
    finished: Path, tmp_path: Path, run: Run, command: str
) -> None:
    folder = copied(finished, tmp_path / "study")
    content = bytearray((folder / STORE).read_bytes())
    content[-9000:] = bytes(9000)
    (folder / STORE).write_bytes(content)
    options = ("report", folder) if command == "report" else ("compare", "--out", folder)
    refused(run(*options), STORE, "is damaged", "sqlite3", ".recover")
    assert (folder / STORE).read_bytes() == content


@pytest.mark.long
def test_changed_bytes_are_refused_or_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(12)
    finish(tmp_path, 12).close()
    content, refusals = (tmp_path / STORE).read_bytes(), []
    for number in range(60):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / STORE).write_bytes(changed(content, rng))
        try:
            with Store(folder) as store:
                content_of(store)
        except InputError as error:
            refusals.append(str(error))
    assert all(STORE in told for told in refusals)
    assert len(refusals) > 20


# ----------------------------------------------------------------- full disks and deaths


#: Adds fits to a store until something is in the way; the argument is the largest file.
FILLING = """
import resource, sys
sys.path.insert(0, {here!r})
from pathlib import Path
import numpy as np
from stores import fit
from pilotid.study.table import Store
from pilotid.support.types import InputError
rng = np.random.default_rng(1)
with Store(Path(sys.argv[1]), create=True) as store:
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
    try:
        for number in range(99_000):
            store.add(fit(("first", "mle", 1000 + number), rng))
    except InputError as error:
        print(number, error)
        sys.exit(2)
"""


def test_a_full_disk_is_a_sentence_and_costs_nothing(
    finished: Path, whole: Content, tmp_path: Path
) -> None:
    folder = copied(finished, tmp_path / "study")
    done = subprocess.run(
        [sys.executable, "-c", FILLING.format(here=HERE), folder, "300000"],
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (2, "")
    number, sentence = done.stdout.split(" ", 1)
    assert sentence.startswith(str(folder / STORE))
    with Store(folder, create=True) as store:
        assert len(store.fits()) == len(whole.fits) + int(number)
        store.add(Fit("second", "mle", 10**6, "crashed"))  # it goes on


#: Makes a store and fills it, and dies in the n-th statement that SQLite traces.
DYING = """
import os, sqlite3, sys
sys.path.insert(0, {here!r})
from pathlib import Path
from stores import finish
left = int(sys.argv[2])
def trace(statement):
    global left
    left -= 1
    if left < 0:
        os._exit(9)
connect = sqlite3.connect
def connected(*args, **kwargs):
    base = connect(*args, **kwargs)
    base.set_trace_callback(trace)
    return base
sqlite3.connect = connected
finish(Path(sys.argv[1]), 3).close()
"""


def test_a_death_at_any_statement_leaves_a_whole_store(tmp_path: Path) -> None:
    finish(tmp_path, 3).close()
    with Store(tmp_path) as store:
        whole = content_of(store)
    rng = np.random.default_rng(5)
    for number in [*range(0, 24, 8), *rng.integers(24, 38, 3).tolist()]:
        folder = tmp_path / str(number)
        folder.mkdir()
        program = DYING.format(here=HERE)
        done = subprocess.run([sys.executable, "-c", program, folder, str(number)])
        assert done.returncode == 9
        with Store(folder, create=True) as store:
            for found in store.fits():
                assert found.key in whole.fits
        with finish(folder, 3) as store:
            content = content_of(store)
            assert (content.about, content.fits.keys()) == (whole.about, whole.fits.keys())


# ------------------------------------------------------------------------ rights, two at once


#: Opens stores as they are named on standard input, as soon as they are.
OPENING = """
import sys
from pathlib import Path
from pilotid.study.table import Fit, Store
print("ready", flush=True)
for line in sys.stdin:
    with Store(Path(line.strip()), create=True) as store:
        store.describe({"seed": "1"})
        store.add(Fit("first", "mle", int(sys.argv[1]), "crashed"))
    print("done", flush=True)
"""


def test_two_can_write_one_store(tmp_path: Path) -> None:
    with ExitStack() as closing_all:  # of the pipes, whatever fails
        pair = [
            closing_all.enter_context(
                subprocess.Popen(
                    [sys.executable, "-c", OPENING, str(1000 + number)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    text=True,
                    bufsize=1,
                )
            )
            for number in range(2)
        ]

        def heard(word: str) -> None:
            for process in pair:
                assert process.stdout is not None
                assert process.stdout.readline().strip() == word

        heard("ready")
        for number in range(50):
            folder = tmp_path / str(number)
            folder.mkdir()
            Store(folder, create=True).close()
            for process in pair:
                assert process.stdin is not None
                process.stdin.write(f"{folder}\n")
            heard("done")
            with Store(folder) as store:
                assert {fit.replication for fit in store.fits()} == {1000, 1001}


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", "\xff", '{"scenario": 1}', '{"scenario": "first"}']
)
def test_rows_that_are_none_are_refused(
    finished: Path, tmp_path: Path, run: Run, content: str
) -> None:
    folder = copied(finished, tmp_path / "stranger")
    with closing(sqlite3.connect(folder / STORE)) as base:
        base.execute("UPDATE rows SET content=? WHERE replication = 3", (content,))
        base.commit()
    refused(run("report", folder), "is damaged", ".recover")
