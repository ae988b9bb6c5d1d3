"""The command line.

Imports everything, heavy libraries where they are used.  Start at `main`: one function a
command; `options` says what options mean.
"""

import os
from typing import NoReturn

# Matrices here are small: threads of linear algebra only wait for one another, on a busy machine
# for longer than the work takes. numpy reads this when it is imported; who sets it, has it so.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# Pages have figures, and no command has windows.
os.environ["MPLBACKEND"] = "agg"


def start() -> NoReturn:
    """The program; Ctrl-C ends it in a sentence also while it imports."""
    try:
        from pilotid.cli.main import main

        main()
    except KeyboardInterrupt:
        os.write(2, b"pilotid: stopped\n")
        raise SystemExit(130) from None
