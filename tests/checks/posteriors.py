"""Write the reference posteriors of the fixed tasks in datasets/tasks: long runs of `bayes`.

    nox -s check -- posteriors

Each has 1,000 draws, evenly from 10,000 effective ones at least, in single precision.  Exit
status 1 if R-hat of a parameter is not below 1.01.
"""

from __future__ import annotations

import io
import sys

import numpy as np

from pilotid.datasets.named import TASKS, fixed_tasks, load_task
from pilotid.estimate.method import identify
from pilotid.methods.bayes import Bayes
from pilotid.support.numbers import fit_rng

DRAWS, EFFECTIVE, STEPS = 1000, 10_000.0, 50_000

if __name__ == "__main__":
    METHOD, kept = Bayes(effective=EFFECTIVE, most=STEPS), {}
    for name in fixed_tasks():
        task = load_task(name)
        draws = identify(METHOD, task.recording, task.model, fit_rng(1, "bayes", name)).draws
        if draws is None or not draws.converged or draws.r_hat.max() >= 1.01:
            sys.exit(f"{name}: the run has not converged")
        print(
            f"{name:20} effective {draws.effective.min():6.0f}  R-hat {draws.r_hat.max():.4f}",
            f"autocorrelation {draws.autocorrelation.max():5.1f} steps",
            f"accepted {100.0 * draws.acceptance:.0f} %",
            flush=True,
        )
        for key, values in zip(draws.keys, draws.thinned(DRAWS).T, strict=True):
            kept[f"{name}.{key}"] = values.astype(np.float32)
    stream = io.BytesIO()
    np.savez_compressed(stream, **kept)
    (TASKS / "posteriors.npz").write_bytes(stream.getvalue())
    print(len(stream.getvalue()), "bytes")
