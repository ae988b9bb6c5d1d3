"""What may happen to a store: changed bytes, a full disk, no rights, deaths, two at once."""

from __future__ import annotations

import ctypes
import os
import resource
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
from helpers import Answer, Run
from stores import Content, changed, content_of, finish

from pilotid.store import STORE
from pilotid.study.store import Result, Store, Unit
from pilotid.support.types import InputError

HERE = str(Path(__file__).parent)
REPORT = ("estimates.csv", "summary.csv", "report.md", "report.html")


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


def units() -> Iterator[Unit]:
    return (Unit("first", "mle", number) for number in range(1000, 100_000))


#: Adds fits to a store until something is in the way; the argument is the largest file.
FILLING = """
import resource, sys
sys.path.insert(0, {here!r})
from pathlib import Path
import numpy as np
from stores import fit
from test_store_faults import units
from pilotid.study.store import Store
from pilotid.support.types import InputError
rng = np.random.default_rng(1)
with Store(Path(sys.argv[1]), create=True) as store:
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
    try:
        for number, unit in enumerate(units()):
            store.add(fit(unit, rng))
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
        assert len(store.done()) == len(whole.fits) + int(number)
        store.add(Result(Unit("second", "mle", 10**6), "crashed"))  # it goes on


def test_reports_on_a_full_disk_are_a_sentence(finished: Path, tmp_path: Path) -> None:
    folder = copied(finished, tmp_path / "study")
    done = subprocess.run(
        [sys.executable, "-c", "from pilotid.cli.main import main; main()", "report", folder],
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000)),
    )
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert "cannot be" in done.stderr


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
            for unit in store.done():
                assert unit in whole.fits
        with finish(folder, 3) as store:
            assert content_of(store).about == whole.about
            assert store.done().keys() == whole.fits.keys()


# ------------------------------------------------------------------------ rights, two at once


def override_rights(allowed: bool) -> None:
    """Whether root may write where the rights of files do not allow it (capset(2))."""
    libc = ctypes.CDLL(None, use_errno=True)
    header = (ctypes.c_uint32 * 2)(0x20080522, 0)  # version 3, this thread
    sets = (ctypes.c_uint32 * 6)()  # effective, permitted and inheritable, twice 32 bits
    override = 1 << 1  # CAP_DAC_OVERRIDE
    assert libc.capget(header, sets) == 0
    sets[0] = sets[0] | (override & sets[1]) if allowed else sets[0] & ~override
    assert libc.capset(header, sets) == 0


@contextmanager
def without_rights() -> Iterator[None]:
    """Let rights of files stop root, too, for a while."""
    root = os.geteuid() == 0
    if root:
        override_rights(False)
    try:
        yield
    finally:
        if root:
            override_rights(True)


@pytest.fixture
def read_only(finished: Path) -> Iterator[Path]:
    """A folder that can be read and not written, with a finished study."""
    top = Path(tempfile.mkdtemp())
    folder = copied(finished, top / "a study?#")
    (folder / STORE).chmod(0o444)
    folder.chmod(0o555)
    yield folder
    folder.chmod(0o755)
    shutil.rmtree(top)


def test_what_cannot_be_written_can_be_reported_on(
    read_only: Path, whole: Content, run: Run
) -> None:
    out = read_only.parent / "out"
    out.mkdir()
    with without_rights():
        with Store(read_only) as store:
            assert content_of(store) == whole
        elsewhere = run("report", read_only, "--out", out)
        here = run("report", read_only)
        with pytest.raises(InputError, match="cannot be read or written"):
            Store(read_only, create=True)
    assert elsewhere.status == 0, elsewhere.err
    assert all((out / name).exists() for name in REPORT)
    refused(here, "cannot be written", "its rights")
    assert [path.name for path in read_only.iterdir()] == [STORE]


def test_a_log_that_cannot_be_merged_is_read(read_only: Path, whole: Content) -> None:
    read_only.chmod(0o755)
    (read_only / STORE).unlink()
    program = f"import os, sys; sys.path.insert(0, {HERE!r})\n"
    program += "from pathlib import Path; from stores import finish\n"
    program += "finish(Path(sys.argv[1])); os._exit(0)"
    subprocess.run([sys.executable, "-c", program, read_only], check=True)
    (read_only / f"{STORE}-shm").unlink()
    assert (read_only / f"{STORE}-wal").stat().st_size > 0
    before = {path.name: path.read_bytes() for path in read_only.iterdir()}
    read_only.chmod(0o555)
    with without_rights(), Store(read_only) as store:
        assert content_of(store) == whole
    assert {path.name: path.read_bytes() for path in read_only.iterdir()} == before


#: Opens stores as they are named on standard input, as soon as they are.
OPENING = """
import sys
from pathlib import Path
from pilotid.study.store import Result, Unit
from pilotid.study.store import Store
print("ready", flush=True)
for line in sys.stdin:
    with Store(Path(line.strip()), create=True) as store:
        store.describe({"seed": "1"})
        store.add(Result(Unit("first", "mle", int(sys.argv[1])), "crashed"))
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
                assert {unit.replication for unit in store.done()} == {1000, 1001}


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("remnant ratio nominal", "{{ 7*7 }}"),
    ],
)
def test_facts_that_no_report_could_read_are_refused(
    finished: Path, tmp_path: Path, run: Run, key: str, value: str
) -> None:
    folder = copied(finished, tmp_path / "stranger")
    with Store(folder, create=True) as store:
        store.describe({key: value})
    refused(run("report", folder), "is damaged")


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", "\xff", '{"unit": 1}', '{"unit": {"scenario": "first"}}']
)
def test_rows_that_are_none_are_refused(
    finished: Path, tmp_path: Path, run: Run, content: str
) -> None:
    folder = copied(finished, tmp_path / "stranger")
    with closing(sqlite3.connect(folder / STORE)) as base:
        base.execute("UPDATE rows SET content=? WHERE replication = 3", (content,))
        base.commit()
    refused(run("report", folder), "is damaged", ".recover")
