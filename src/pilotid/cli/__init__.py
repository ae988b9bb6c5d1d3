"""The command line.

Imports everything, heavy libraries where they are used.  Start at `main`: one function a
command; `arguments` says what options mean.
"""

import os

# Matrices here are small: threads of linear algebra only wait for one another, on a busy machine
# for longer than the work takes. numpy reads this when it is imported; who sets it, has it so.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
