"""Coverage of `mle`, and how often its right fits are warned of; `recorder` tells of faults.

    nox -s check -- remarks --recordings 100 [--first 1000] [--only population-usual,zero]

A fit is right if no value that it tells (`Estimate.determined`) is off by more than four claimed
errors; what is graded wrong or doubt of it, or of its recording, is a false alarm.  `zero` has
elements with a zero; ``strata:NAME`` is a generator that shares no code with this one; scenarios
named ``NAME*`` are all that begin so.  Last, what is said of the recordings of people that
PILOTID_MEASURED names.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from recorder import FAULTS, bare, with_zero
from strata import STRATA as OF_OWN
from strata import of_stratum

from pilotid.checks.checks import remarks
from pilotid.checks.element_fit import chosen_element
from pilotid.datasets import POPULATIONS, SCENARIOS, simulate
from pilotid.estimate.estimate import Estimate
from pilotid.estimate.method import identify
from pilotid.methods import method_named
from pilotid.model.model import PilotModel
from pilotid.recording.files import load_recording
from pilotid.recording.recording import Recording

SEED, FAR = 1, 4.0  # claimed errors
STRATA = (
    *(f"population-{n}" for n in ("usual", "exotic", "aperiodic", "short", "recorded")),
    *("zero", "decimals", "bare", "violation-*", "recorder-*"),
    *(f"strata:{name}" for name in OF_OWN),
)


def drawn(
    name: str, first: int, count: int
) -> Iterator[tuple[Recording, PilotModel, dict[str, float]]]:
    """Recordings of a stratum, each with its model and truth."""
    if name.startswith("strata:"):
        yield from (
            of_stratum(name.removeprefix("strata:"), i) for i in range(first, first + count)
        )
        return
    named = [s for s in SCENARIOS if s.startswith(name.rstrip("*"))] if "*" in name else []
    for i in range(first, first + count):
        rng = np.random.default_rng([SEED, i, *name.encode()])
        source = "usual" if name in ("bare", "decimals") else name.removeprefix("population-")
        if named:
            scenario = SCENARIOS[named[i % len(named)]]
        else:
            scenario = (
                with_zero(rng) if name == "zero" else POPULATIONS[f"population-{source}"].drawn(rng)
            )
        recording = simulate(scenario, rng)
        if name == "bare":
            recording = bare(recording, *(("ft",), ("fd",), ())[i % 3])
        if name == "decimals":
            recording = FAULTS["all 3 decimals"](recording, rng)
        yield recording, scenario.model, dict(zip(scenario.model.keys, scenario.truth, strict=True))


def loud_of(recording: Recording, estimate: Estimate | None = None) -> dict[str, str]:
    """Codes of the doubts of a recording, and of an estimate of it, with their worst grades."""
    told = [*remarks(recording), *chosen_element(recording).remarks]
    told += estimate.remarks if estimate else ()
    grades = ("doubt", "wrong")
    return {r.code: r.grade for grade in grades for r in told if r.grade == grade}


def false_alarms(name: str, first: int, count: int) -> None:
    """Print a row: coverage, fits that are off, and how often right fits are warned of, by code."""
    right = wrong = alarmed = silent = 0
    codes, covered = Counter[str](), list[float]()
    for i, (recording, model, truth) in enumerate(drawn(name, first, count), first):
        estimate = identify(method_named("mle"), recording, model, np.random.default_rng(i))
        if not estimate.outcome.usable:
            continue
        loud = loud_of(recording, estimate)
        true = np.array([truth[key] for key in model.keys])
        low, high = estimate.intervals.T
        covered.append(float(np.mean((low <= true) & (true <= high))))
        is_off = np.abs(estimate.values - true) > FAR * estimate.std_error
        if np.any(is_off & estimate.determined):
            silent += not loud
            wrong += 1
            continue
        right += 1
        codes.update(f"{code} ({grade})" for code, grade in loud.items())
        alarmed += bool(loud)
        if "wrong" in loud.values():
            codes["any wrong"] += 1
            print(f"    {name} {i}: {', '.join(c for c, g in loud.items() if g == 'wrong')}")
    shares = ", ".join(f"{code} {n}" for code, n in codes.most_common())
    error = np.std(covered) / np.sqrt(len(covered))
    print(
        f"| {name} | {len(covered)} of {count} | {np.mean(covered):.3f} ± {error:.3f} | {wrong} | "
        f"{silent} | {100 * codes['any wrong'] / max(right, 1):.1f} % | "
        f"{100 * alarmed / max(right, 1):.1f} % | {shares}",
        flush=True,
    )


def of_people(folder: Path) -> None:
    """Print what is said of every measured recording."""
    preview = {"t": "time", "u": "inp", "ft": "ref", "fd": "dis", "x": "state"}
    files = [(f, None) for f in sorted(folder.glob("[ay]*/*.mat"))]
    files += [(f, None) for f in sorted(folder.glob("rollpitch/pilot*.csv"))]
    files += [(f, preview) for f in sorted(folder.glob("preview*/*.csv"))]
    course, fd = folder / "course" / "ae4320_dataset.mat", {"fd": "-3.49*fd"}
    files += [(Path(f"{course}::{part}"), fd) for part in ("identification", "validation")]
    count, total = Counter[str](), Counter[str]()
    for file, mapping in files:
        recording = load_recording(file, mapping=mapping)
        total[file.parent.name] += 1
        for code, grade in loud_of(recording).items():
            count[f"{file.parent.name} {grade} {code}"] += 1
            print(f"    {file.parent.name}/{file.stem}: {grade} {code}")
    print(f"people: {dict(total)}; {dict(count)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--only", default=",".join((*STRATA, "people")))
    given = parser.parse_args()
    print("| recordings | usable fits | coverage | off | silent | wrong | doubted | codes")
    for name in given.only.split(","):
        if name == "people":
            of_people(Path(os.environ["PILOTID_MEASURED"]))
        else:
            false_alarms(name, given.first, given.recordings)


if __name__ == "__main__":
    main()
