"""The command line.

Imports everything, heavy libraries where they are used.  Start at `main`: one function a
command; `arguments` says what options mean.
"""

import os
import signal
from typing import NoReturn

# Matrices here are small: threads of linear algebra only wait for one another, on a busy machine
# for longer than the work takes. numpy reads this when it is imported; who sets it, has it so.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# Pages have figures, and no command has windows.
os.environ["MPLBACKEND"] = "agg"


def start() -> NoReturn:
    """The program: Ctrl-C ends it in a sentence also while it imports, and at its end."""

    def end(*_: object) -> None:
        try:
            os.write(2, b"pilotid: stopped\n")
        finally:  # whether that can be said or not
            os._exit(130)

    heeded = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if heeded:
        signal.signal(signal.SIGINT, end)
    from pilotid.cli.main import main

    if heeded:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        main()
    finally:
        if heeded:
            signal.signal(signal.SIGINT, end)
