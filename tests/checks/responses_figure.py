"""Figure of docs/guide/methods.md: frequency responses of one recording of `nominal`.

nox -s check -- responses       writes docs/responses.svg
"""

from __future__ import annotations

import argparse
from pathlib import Path

from pilotid.datasets import scenario_named, simulate
from pilotid.estimates.method import identify
from pilotid.methods import methods
from pilotid.report.page import svg
from pilotid.show.plots import response_figure
from pilotid.support.numbers import fit_rng, recording_rng

SCENARIO = "nominal"
FILE = Path(__file__).parents[2] / "docs" / "responses.svg"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    seed = parser.parse_args().seed
    scenario = scenario_named(SCENARIO)
    recording = simulate(scenario, recording_rng(seed, SCENARIO))
    estimates = [
        identify(method, recording, scenario.model, fit_rng(seed, method.name, SCENARIO))
        for method in methods().values()
    ]
    shown = [e for e in estimates if e.frequency_response is not None]
    for estimate in shown:
        print(f"{estimate.method}: {estimate.sentence}")
    alt = "Describing functions by the two-step methods, and the truth"
    text = svg(response_figure(shown, scenario.values), "responses", alt)
    FILE.write_text('<?xml version="1.0" encoding="utf-8"?>\n' + text, encoding="utf-8")
    print(FILE)


if __name__ == "__main__":
    main()
