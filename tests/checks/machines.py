"""How far estimates differ between machines, measured.

    nox -s check -- machines     10 minutes

Every method fits the same recordings in child processes that compute as different processors
do, with one thread and with two, see `processors.py`; a second process like the first shows
what one machine does twice.  Differences are in units of the claimed standard errors.
`--store` writes what `tests/test_machines.py` compares other machines with.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from processors import NATIVE, Processor, runnable

from pilotid.datasets import SCENARIOS
from pilotid.estimates.method import identify
from pilotid.methods import METHODS
from pilotid.support.numbers import fit_rng, recording_rng

FAMILIES = ("nominal", "single", "white-remnant", "remnant-0.8", "disturbance-step", "runs-2")
#: What the stored estimates are of: 60 fits, one and several runs, white and coloured remnants.
STORED = ("nominal", "single", "runs-2", "white-remnant", "training")
REFERENCE = Path(__file__).parent.parent / "machines.json"


def fits(names: tuple[str, ...], replications: int) -> dict[str, Any]:
    """Outcome, values and claimed errors of every method on every recording."""
    from pilotid.datasets import simulate

    found: dict[str, Any] = {}
    for name in names:
        scenario = SCENARIOS[name]
        for replication in range(replications):
            recording = simulate(scenario, recording_rng(1, name, replication))
            for method in METHODS:
                rng = fit_rng(1, method.name, name, replication)
                estimate = identify(method, recording, scenario.model, rng)
                usable = estimate.outcome.usable
                found[f"{method.name} {name} {replication}"] = {
                    "outcome": estimate.outcome.slug,
                    "values": estimate.values.tolist() if usable else [],
                    "std_error": estimate.std_error.tolist() if usable else [],
                    "intervals": estimate.intervals.tolist() if usable else [],
                }
    return found


def fits_of(processor: Processor, threads: int, replications: int) -> dict[str, Any]:
    """The same from a child process that computes as a processor does."""
    done = subprocess.run(
        (sys.executable, __file__, "--child", "--replications", str(replications)),
        env=processor.environment(threads),
        stdout=subprocess.PIPE,
        check=True,
    )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def compared(first: dict[str, Any], other: dict[str, Any], method: str) -> str:
    """A cell of the table: the largest difference of any value of any fit."""
    keys = [key for key in first if key.split()[0] == method]
    if all(first[key] == other[key] for key in keys):
        return "same bits"
    changed = sum(first[key]["outcome"] != other[key]["outcome"] for key in keys)
    apart = [
        np.abs(np.subtract(other[key]["values"], first[key]["values"])) / first[key]["std_error"]
        for key in keys
        if first[key]["values"] and other[key]["values"]
    ]
    largest = f"{np.max(np.concatenate(apart)):.0e}"
    return f"{largest}, {changed} other outcomes" if changed else largest


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--replications", type=int, default=4)
    parser.add_argument("--store", action="store_true", help="write tests/machines.json")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    settings = parser.parse_args()
    if settings.child:
        print(json.dumps(fits(FAMILIES, settings.replications)))
        return
    if settings.store:
        REFERENCE.write_text(json.dumps(fits(STORED, 1), indent=1) + "\n", encoding="utf-8")
        return
    processors, sentences = runnable()
    print("\n".join(sentences), flush=True)
    first = fits_of(NATIVE, 1, settings.replications)
    runs = [(NATIVE, 1), *((p, t) for p in processors for t in (1, 2))]
    others = {
        f"{processor.name} {threads}": fits_of(processor, threads, settings.replications)
        for processor, threads in runs
    }
    print(f"\n{len(first) // len(METHODS)} recordings, against native 1\n")
    print("| method | " + " | ".join(others) + " |")
    print("| --- |" + " --- |" * len(others))
    for method in METHODS:
        cells = [compared(first, other, method.name) for other in others.values()]
        print(f"| `{method.name}` | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
