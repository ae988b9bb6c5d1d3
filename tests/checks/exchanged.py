"""Errors of two recordings with exchanged lines, fitted alone and together.

    nox -s check -- exchanged

Target and disturbance of `nominal` with a third of its remnant, and of a pilot who looks ahead, on
each other's lines in the second recording.  Ratios are of rms errors: 0.71 says that the recordings
add up.  (With all of its remnant gain and lead are known to a third, and skewed.)
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from pilotid.api import identify
from pilotid.datasets import SCENARIOS, Scenario, simulate
from pilotid.pilot.catalogue import LOOK_AHEAD
from pilotid.pilot.element import single_integrator
from pilotid.recordings.recording import joined
from pilotid.support.types import FloatArray

NOMINAL = SCENARIOS["nominal"]
NOMINAL = replace(NOMINAL, remnant=replace(NOMINAL.remnant, level=0.05))
LOOKING = replace(
    NOMINAL,
    name="look-ahead",
    remnant=SCENARIOS["nominal"].remnant,
    model=LOOK_AHEAD,
    truth=(1.2, 0.35, 1.1, 0.2, 0.2, 10.0, 0.4),
    element=single_integrator(1.2),
)
METHODS = {"nominal": ("mle", "fourier", "arx"), "look-ahead": ("mle", "fourier")}


def exchanged(scenario: Scenario) -> Scenario:
    """The same with target and disturbance on each other's lines."""
    target, disturbance = scenario.target, scenario.disturbance
    return replace(
        scenario,
        target=replace(target, lines=disturbance.lines),  # type: ignore[type-var, union-attr]
        disturbance=replace(disturbance, lines=target.lines),  # type: ignore[type-var, union-attr]
    )


def errors_of(scenario: Scenario, method: str, count: int) -> FloatArray:
    """Errors and claimed errors of first, second and both, shape (2, count, 3, parameters)."""
    found = np.full((2, count, 3, len(scenario.values)), np.nan)
    for i in range(count):
        pair = [
            simulate(own, np.random.default_rng([place, i]))
            for place, own in enumerate((scenario, exchanged(scenario)))
        ]
        for place, recording in enumerate((*pair, joined(pair))):
            fit = identify(method, recording, scenario.model, rng=i)
            if fit.outcome.usable:
                found[:, i, place] = fit.values - scenario.values, fit.std_error
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=80)
    count = parser.parse_args().recordings
    for scenario in (NOMINAL, LOOKING):
        keys = scenario.model.keys
        print(f"\n| {scenario.name} | | {' | '.join(keys)} |\n|{' --- |' * (2 + len(keys))}")
        for method in METHODS[scenario.name]:
            errors, claims = errors_of(scenario, method, count)
            share = 100.0 * errors / scenario.values
            size = np.sqrt(np.nanmean(share**2, axis=0))
            alone = np.sqrt(2.0 / (size[0] ** -2 + size[1] ** -2))
            chance = np.nanstd(share, axis=0) / np.sqrt(np.isfinite(share).sum(axis=0))
            bias = np.nanmean(share, axis=0)
            standard = np.sqrt(np.nanmean((errors / claims) ** 2, axis=0))[2]
            rows = {
                "rms error alone [%]": [f"{v:.2f}" for v in alone],
                "together [%]": [f"{v:.2f}" for v in size[2]],
                "ratio": [f"{v:.2f}" for v in size[2] / alone],
                "bias alone [%]": _with_errors(bias[:2].mean(axis=0), 0.5 * np.hypot(*chance[:2])),
                "bias together [%]": _with_errors(bias[2], chance[2]),
                "rms error over claimed, together": [f"{v:.2f}" for v in standard],
            }
            for words, shown in rows.items():
                print(f"| {method} | {words} | {' | '.join(shown)} |", flush=True)


def _with_errors(values: FloatArray, errors: FloatArray) -> list[str]:
    return [f"{v:+.2f} ± {e:.2f}" for v, e in zip(values, errors, strict=True)]


if __name__ == "__main__":
    main()
