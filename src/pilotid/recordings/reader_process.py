"""The process that reads all files but text: a damaged one can end it, and nothing else.

It is started for the first file, within limits of memory and time, and reads all others as well.
"""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path

from pilotid.disk import require_file
from pilotid.recordings.containers import damage_error, read_container
from pilotid.recordings.contents import Contents, Parts, Place
from pilotid.types import InputError

LARGEST_FILE = 2**32  # bytes
MEMORY = 2**31  # bytes of address space, that of libraries included
SECONDS = 30  # for one file
_LOCK = threading.Lock()


@cache
def _process(owner: int) -> subprocess.Popen[bytes]:
    """The reader of the process with this id; one that was forked has another."""
    limits = {"PYTHONPATH": os.pathsep.join(map(str, sys.path)), "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", __name__],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, **limits},
    )
    atexit.register(_end, process)
    return process


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.communicate()


def _ask(request: bytes) -> object:
    """What the reader answers; a request that ends it leaves the next one to a new reader."""
    process = _process(os.getpid())
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        process.stdin.write(request)
        process.stdin.flush()
        return pickle.load(process.stdout)
    except BaseException as error:  # when interrupted, the next answer must not be this one
        _end(process)
        _process.cache_clear()
        if isinstance(error, OSError | EOFError | pickle.UnpicklingError):
            return None
        raise


def read_apart(
    path: Path, source: str, places: Mapping[str, Place], parts: Parts, *, timed: bool
) -> Contents | list[str]:
    """Read a file that is no text; see `pilotid.recordings.containers.read_container`.

    Raises
    ------
    InputError
        With the variable that is wrong.
    OSError
        If the file cannot be read.
    """
    require_file(path, LARGEST_FILE)
    request = pickle.dumps((path.absolute(), source, dict(places), parts, timed))
    with _LOCK:
        answer = _ask(request) or _ask(request)  # a file read before may have harmed the first
    if isinstance(answer, Exception):
        raise answer
    if not isinstance(answer, Contents | list):
        raise damage_error(source, path.suffix.lower(), "reading it failed")
    return answer


def _serve() -> None:
    """Answer requests until there are no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who asks ends this process
    warnings.simplefilter("ignore")
    with suppress(ImportError, ValueError, OSError):  # not every system has limits
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_AS)
        limit = MEMORY if most == resource.RLIM_INFINITY else min(MEMORY, most)
        resource.setrlimit(resource.RLIMIT_AS, (limit, most))
    alarm = getattr(signal, "alarm", int)  # not every system has one
    with suppress(EOFError):
        while True:
            path, source, places, parts, timed = pickle.load(sys.stdin.buffer)
            alarm(SECONDS)
            try:
                answer: object = read_container(path, source, places, parts, timed=timed)
            except (InputError, OSError) as error:
                answer = error
            alarm(0)
            pickle.dump(answer, sys.stdout.buffer, protocol=5)
            sys.stdout.buffer.flush()


if __name__ == "__main__":
    _serve()
