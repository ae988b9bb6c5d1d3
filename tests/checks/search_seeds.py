"""Does `mle` end at the same optimum whatever seed draws the starts of its search?

    nox -s check -- search-seeds --model multi FILES...

A line for each recording: how far criteria lie apart, how far values lie apart in claimed errors,
models of the remnant, outcomes and seconds.  Ends with status 1 if values of one recording differ
by more than a tenth of their errors.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from pathlib import Path

import numpy as np

from pilotid.estimates.method import identify
from pilotid.methods.mle import MLE
from pilotid.pilot.catalogue import MODELS
from pilotid.recordings.files import load_recording

APART = 0.1  # claimed errors


def ends(file: Path, model: str, seeds: int) -> bool:
    """Print how the fits of one file differ; whether they end at one optimum."""
    recording = load_recording(file)
    begin = time.perf_counter()
    fits = [
        identify(MLE(), recording, MODELS[model], np.random.default_rng(seed))
        for seed in range(seeds)
    ]
    seconds = (time.perf_counter() - begin) / seeds
    values = np.array([fit.values for fit in fits])
    apart = np.ptp(values, axis=0) / fits[0].std_error
    criteria = np.ptp([fit.criterion for fit in fits])
    models = Counter(fit.remnant.model for fit in fits if fit.remnant is not None)
    outcomes = Counter(fit.outcome.slug for fit in fits)
    told = [", ".join(f"{n} {name}" for name, n in c.items()) for c in (models, outcomes)]
    print(
        f"{file.stem:34s} {model:7s} criterion {criteria:.2g}  values {np.max(apart):.2g}  "
        f"{'  '.join(told)}  {seconds:.2f} s",
        flush=True,
    )
    return bool(np.max(apart) <= APART)


def main() -> int:
    """Fit each file with many seeds."""
    parser = argparse.ArgumentParser(description="Optima of mle with different seeds")
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--model", default="multi", choices=MODELS)
    parser.add_argument("--seeds", type=int, default=10)
    asked = parser.parse_args()
    alike = [ends(file, asked.model, asked.seeds) for file in asked.files]
    return 0 if all(alike) else 1


if __name__ == "__main__":
    raise SystemExit(main())
