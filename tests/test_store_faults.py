"""What may happen to a store: changed bytes, a full disk."""

from __future__ import annotations

import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from helpers import Answer, Run
from stores import finish

from pilotid.study.table import Fit, Store
from pilotid.support.store import STORE

HERE = str(Path(__file__).parent)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    finish(folder).close()
    return folder


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
    refused(run(*options), STORE, "cannot be read or written")
    assert (folder / STORE).read_bytes() == content


# --------------------------------------------------------------------------- full disks


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


def test_a_full_disk_is_a_sentence_and_costs_nothing(finished: Path, tmp_path: Path) -> None:
    folder = copied(finished, tmp_path / "study")
    with Store(folder) as store:
        before = len(store.fits())
    done = subprocess.run(
        [sys.executable, "-c", FILLING.format(here=HERE), folder, "300000"],
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (2, "")
    number, sentence = done.stdout.split(" ", 1)
    assert sentence.startswith(str(folder / STORE))
    with Store(folder, create=True) as store:
        assert len(store.fits()) == before + int(number)
        store.add(Fit("second", "mle", 10**6, "crashed"))  # it goes on


@pytest.mark.parametrize("content", ["", "{}", '{"scenario": "first"}'])
def test_rows_that_are_none_are_refused(
    finished: Path, tmp_path: Path, run: Run, content: str
) -> None:
    folder = copied(finished, tmp_path / "stranger")
    with closing(sqlite3.connect(folder / STORE)) as base:
        base.execute("UPDATE rows SET content=? WHERE replication = 3", (content,))
        base.commit()
    refused(run("report", folder), STORE)
