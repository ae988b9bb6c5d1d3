"""The process that reads MATLAB files: a damaged one can end it, and nothing else.

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
from pathlib import Path

from pilotid.disk import require_file
from pilotid.recordings.contents import Contents, Place
from pilotid.recordings.matlab import damage_error, read_contents
from pilotid.types import InputError

LARGEST_FILE = 2**32  # bytes
MEMORY = 2**31  # bytes of address space, that of libraries included
SECONDS = 30  # for one file


class _Reader:
    """The process, started when it is first needed."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.process: subprocess.Popen[bytes] | None = None

    def answer(self, request: bytes) -> object:
        """What the process answers; None if the request ends it."""
        with self.lock:
            tries = 1 if self.process is None else 2  # an earlier file may have harmed it
            for _ in range(tries):
                try:
                    return self._asked(request)
                except (OSError, EOFError, pickle.UnpicklingError):
                    self.stop()
                except BaseException:  # interrupted: the next answer must not be this one
                    self.stop()
                    raise
        return None

    def _asked(self, request: bytes) -> object:
        if self.process is None:
            same_path = {
                "PYTHONPATH": os.pathsep.join(map(str, sys.path)),
                "OPENBLAS_NUM_THREADS": "1",
            }
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **same_path},
            )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(request)
        self.process.stdin.flush()
        return pickle.load(self.process.stdout)

    def stop(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.communicate()
            self.process = None


#: The last one is this process's own; those before it belong to processes it was forked from.
_READERS = [_Reader()]
atexit.register(lambda: _READERS[-1].stop())
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=lambda: _READERS.append(_Reader()))


def read_mat(path: Path, source: str, places: Mapping[str, Place], *, timed: bool) -> Contents:
    """Read a MATLAB file; see `pilotid.recordings.text.read_text`.

    Raises
    ------
    InputError
        With the variable that is wrong.
    OSError
        If the file cannot be read.
    """
    require_file(path, LARGEST_FILE)
    answer = _READERS[-1].answer(pickle.dumps((path.absolute(), source, dict(places), timed)))
    if isinstance(answer, Exception):
        raise answer
    if not isinstance(answer, Contents):
        raise damage_error(source, "reading it failed")
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
    with suppress(EOFError):
        while True:
            path, source, places, timed = pickle.load(sys.stdin.buffer)
            _alarm(SECONDS)
            try:
                answer: object = read_contents(path, source, places, timed=timed)
            except (InputError, OSError) as error:
                answer = error
            _alarm(0)
            pickle.dump(answer, sys.stdout.buffer, protocol=5)
            sys.stdout.buffer.flush()


def _alarm(seconds: int) -> None:
    """End this process after so many seconds; 0 for not at all."""
    if hasattr(signal, "alarm"):
        signal.alarm(seconds)


if __name__ == "__main__":
    _serve()
