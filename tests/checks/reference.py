"""Compute `results/reference`, the comparison that README and paper quote; it resumes.

    nox -s check -- reference [--out DIR] [further options of pilotid compare, as --workers 2]

What DIR/study.sqlite holds already is kept, so that it can be stopped at any time.  Delete DIR
before the first run with another version.
"""

from __future__ import annotations

import subprocess
import sys

OUT = "results/reference"
SCENARIOS = (
    *("nominal", "single", "white-remnant", "target-step"),
    *(f"population-{kind}" for kind in ("usual", "exotic", "aperiodic", "short", "recorded")),
)
#: Recordings, by methods: draws of a posterior take longest, and the others are of old.
COUNTS = {
    ("mle", "fourier", "arx", "sindy", "mle-white", "mle-reference"): 200,
    ("bayes",): 100,
}
HISTORICAL = {("mmle3", "bayes-white", "mle-genetic"): 100}


def main(arguments: list[str]) -> None:
    options = arguments if "--out" in arguments else [*arguments, "--out", OUT]
    for scenario in SCENARIOS:
        for methods, count in (COUNTS | (HISTORICAL if scenario == "nominal" else {})).items():
            named = [word for method in methods for word in ("--method", method)]
            asked = ["--scenario", scenario, *named, "--replications", str(count)]
            subprocess.run(["pilotid", "compare", *asked, *options], check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
