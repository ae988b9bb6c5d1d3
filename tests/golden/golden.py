"""Numbers that no refactoring may move: `python tests/golden/golden.py` writes them anew.

`estimates.csv`: every method fits three recordings of each of eight scenarios.  A row is a fit:
its outcome, the codes of its remarks, and value, standard error and ends of the interval of each
parameter.  `summary.csv` is that of a small study.  `analysis.csv` has the estimates of four
recordings of people, from the folder that PILOTID_MEASURED names.
"""

from __future__ import annotations

import csv
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy
from threadpoolctl import threadpool_info

import pilotid
from pilotid import SCENARIOS, Scenario

FOLDER = Path(__file__).parent
MEASURED = os.environ.get("PILOTID_MEASURED")
METHODS = (
    *("mmle3", "mle-white", "mle-genetic", "mle", "mle-reference"),
    *("bayes-white", "bayes", "fourier", "arx", "sindy"),
)
RECORDINGS = 3
#: Position control: an element that is a gain, and a pilot who lags.
POSITION = replace(
    SCENARIOS["nominal"],
    name="position",
    model=pilotid.MODELS["lead-lag"],
    truth=(4.0, 0.2, 2.0, 0.25, 12.0, 0.35),
    element=pilotid.element_named("1"),
)
KINDS = (
    *("nominal", "single", "target-step", "disturbance-only", "population-usual"),
    *("runs-5", "adapting-slow", "position"),
)


def rng(*key: int | str) -> np.random.Generator:
    """A generator that does not depend on how the package makes its own."""
    numbers = [int.from_bytes(k.encode(), "big") if isinstance(k, str) else k for k in key]
    return np.random.default_rng(numbers)


def drawn(kind: str, recording: int) -> Scenario:
    """The scenario of a recording; a population draws its pilot."""
    if kind == "position":
        return POSITION
    found = {**SCENARIOS, **pilotid.POPULATIONS}[kind]
    return found.drawn(rng(kind, recording, 0))


def machine() -> str:
    """What decides how a sum is rounded: the processor, and what linear algebra takes it for."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if platform.system() == "Linux" else []
    facts = {line.partition(":")[0].strip(): line.partition(":")[2].strip() for line in lines}
    known = [
        facts[key] for key in ("model name", "cpu family", "model", "stepping") if key in facts
    ]
    kernels = {str(b.get("architecture")) for b in threadpool_info() if b["user_api"] == "blas"}
    parts = (*(known or [platform.processor()]), *sorted(kernels))
    return " ".join((*parts, np.__version__, scipy.__version__, platform.python_version()))


def fits(kind: str, recordings: Iterable[int] = range(RECORDINGS)) -> Iterator[dict[str, str]]:
    """A row for each recording and method of a scenario."""
    for number in recordings:
        scenario = drawn(kind, number)
        recording = pilotid.simulate(scenario, rng(kind, number, 1))
        for method in METHODS:
            estimate = pilotid.identify(method, recording, scenario.model, rng(kind, number, 2))
            table = np.column_stack([estimate.values, estimate.std_error, estimate.intervals])
            yield {
                "scenario": kind,
                "method": method,
                "recording": str(number),
                "outcome": estimate.outcome.slug,
                "codes": " ".join(sorted(estimate.to_dict()["codes"])),
                "numbers": " ".join(f"{v:.12g}" for v in table.ravel())
                if estimate.outcome.usable
                else "",
            }


def command(*words: str, out: Path) -> None:
    """Run a command of the program that writes to a folder."""
    start = (sys.executable, "-c", "from pilotid.cli import start; start()")
    subprocess.run((*start, *words, "--out", str(out)), check=True, capture_output=True)


def summary(out: Path) -> list[dict[str, str]]:
    """The summary of a small study."""
    methods = ("--method", "mle", "--method", "fourier", "--method", "arx")
    scenarios = ("--scenario", "nominal", "--scenario", "population-usual")
    command("compare", *scenarios, *methods, "--replications", "6", out=out)
    return rows_of(out / "summary.csv")


def analysis(measured: str, out: Path) -> list[dict[str, str]]:
    """Estimates of two subjects in two conditions, without the files' names and the remarks."""
    name = "ae2224I_measurement_data_subj{}_{}.mat"
    files = [str(Path(measured, "yaw", name.format(s, c))) for s in (1, 3) for c in ("C2", "C5")]
    pattern = ("--pattern", "ae2224I_measurement_data_subj{subject}_{condition}")
    fitted = ("--model", "single", "--method", "mle", "--method", "fourier")
    command("analyse", *files, *pattern, *fitted, out=out)
    left_out = ("file", "remarks")
    rows = rows_of(out / "estimates.csv")
    return [{k: v for k, v in row.items() if k not in left_out} for row in rows]


def rows_of(path: Path) -> list[dict[str, str]]:
    """The rows of a table."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def written_on() -> str:
    """The machine that the files were written on."""
    return (FOLDER / "estimates.csv").read_text(encoding="utf-8").splitlines()[0][2:]


def write(name: str, rows: list[dict[str, str]]) -> None:
    """Write a file anew."""
    with (FOLDER / name).open("w", newline="", encoding="utf-8") as file:
        file.write(f"# {machine()}\n")
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
    print(name, flush=True)


if __name__ == "__main__":
    write("estimates.csv", [row for kind in KINDS for row in fits(kind)])
    with tempfile.TemporaryDirectory() as folder:
        write("summary.csv", summary(Path(folder, "study")))
        if MEASURED:
            write("analysis.csv", analysis(MEASURED, Path(folder, "analysis")))
