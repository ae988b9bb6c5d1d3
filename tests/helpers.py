"""What several test files share: scenarios, recordings and parts of them, fits, strict JSON."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pilotid.datasets import POPULATIONS, SCENARIOS, Scenario, simulate
from pilotid.estimate.estimate import Estimate, Outcome, symmetric_intervals
from pilotid.estimate.method import Method, identify
from pilotid.estimate.quantities import Draws
from pilotid.likelihood.prediction import Prediction, predict
from pilotid.methods import METHODS
from pilotid.methods.bayes import Bayes
from pilotid.model.catalogue import MODELS
from pilotid.model.element import ControlledElement, element_named
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.solve.least_squares import Box, Minima
from pilotid.support.numbers import fit_rng, recording_rng, start_rng
from pilotid.support.types import BoolArray, FloatArray

NOMINAL = SCENARIOS["nominal"]
SINGLE_LOOP = SCENARIOS["single"]

#: What trained pilots flew in Pool, Harder and van Paassen (2016).
TRAINED = element_named("10.62(s+0.99)/(s(s^2+2.58s+7.61))")
LAGGED = element_named("4/(s(s+1.5))")


def pilot(name: str, truth: tuple[float, ...], element: ControlledElement) -> Scenario:
    """The nominal experiment with a pilot of another model, which names it."""
    model = MODELS[name].with_element(element)
    return replace(NOMINAL, name=name, model=model, truth=truth, element=element)


#: A pilot of each model of the catalogue, in a stable loop, by the model's name.
PILOTS = {
    scenario.model.name: scenario
    for scenario in (
        SINGLE_LOOP,
        NOMINAL,
        pilot("gain", (0.8, 0.28, 12.0, 0.3), element_named("2/s")),
        pilot("lead-lag", (0.6, 1.0, 0.35, 0.28, 13.0, 0.35), element_named("2/s")),
        pilot("rate", (0.35, 1.1, 0.27, 0.25, 0.18, 11.0, 0.4), element_named("4/s^2")),
        pilot("lead-lag-motion", (0.7, 1.3, 0.4, 0.24, 0.3, 0.18, 12.0, 0.35), LAGGED),
        pilot("lead-lag-canals", (0.7, 1.3, 0.4, 0.24, 1.2, 0.18, 12.0, 0.35), LAGGED),
        pilot("lead2-lag", (0.8, 0.45, 0.8, 0.22, 13.0, 0.35), TRAINED),
        pilot(
            "lead2-lag-motion",
            (4.75 * 0.2865, 0.30, 0.95, 0.22, 3.00 * 0.2865, 0.19, 14.0, 0.30),
            TRAINED,
        ),
        pilot("crossover", (2.2, 0.35), element_named("2/s")),
        pilot("precision", (3.0, 0.25, 1.1, 2.5, 8.0, 0.2, 12.0, 0.4), element_named("2/s")),
        pilot("pursuit", (0.8, 0.35, 0.28, 0.35, 0.16, 0.23, 12.0, 0.35), element_named("2/s")),
        pilot("preview", (0.3, 1.1, 0.26, 0.9, 0.25, 0.7, 0.06, 0.12, 0.3, 11.0, 0.35), LAGGED),
        pilot("look-ahead", (1.2, 0.35, 1.1, 0.2, 0.2, 10.0, 0.4), element_named("1.2/s")),
        pilot("following", (0.95, 0.12, 0.21, 12.0, 0.5), element_named("1")),
    )
}


#: Every method with settings that promise the same, where the usual ones take seconds.
QUICK = [
    # Of nonsense it draws as much as it may.
    replace(method, effective=100.0, most=100) if isinstance(method, Bayes) else method
    for method in METHODS.values()
]


def without_remnant(scenario: Scenario) -> Scenario:
    """The scenario of a pilot who does what the model says and nothing else."""
    return replace(scenario, remnant=replace(scenario.remnant, level=0.0, level_is="gain"))


@cache
def recording_of(scenario: Scenario, replication: int = 0, seed: int = 1) -> Recording:
    """The recording that a study with this random seed makes of a replication."""
    return simulate(scenario, recording_rng(seed, scenario.name, replication))


def estimate_at(
    model: PilotModel, values: FloatArray, covariance: FloatArray, **fields: Any
) -> Estimate:
    """An estimate that nobody made, with intervals as its covariance says."""
    intervals = symmetric_intervals(values, covariance)
    known = {"method": "mine", "outcome": Outcome.CONVERGED, **fields}
    return Estimate(model=model, values=values, covariance=covariance, intervals=intervals, **known)


def draws_at(keys: tuple[str, ...], positive: BoolArray, values: FloatArray) -> Draws:
    """Draws that are independent, shape (draws, parameters)."""
    count, parameters = values.shape
    ones, shape = np.ones(parameters), (1, count, 1)
    return Draws(
        keys, positive, values, np.zeros(count), shape, count * ones, ones, ones,
        acceptance=1.0, converged=True,
    )  # fmt: skip


def differences(
    function: Callable[[FloatArray], FloatArray], point: FloatArray, steps: float | FloatArray
) -> FloatArray:
    """Central differences of a function along each coordinate, one behind the other."""
    ways = np.diag(np.broadcast_to(steps, point.shape))
    return np.array(
        [(function(point + way) - function(point - way)) / (2.0 * np.sum(way)) for way in ways]
    )


def fit_of(method: Method, scenario: Scenario, replication: int = 0, seed: int = 1) -> Estimate:
    """The fit that a study with this random seed makes of a replication."""
    recording = recording_of(scenario, replication, seed)
    rng = fit_rng(seed, method.name, scenario.name, replication)
    return identify(method, recording, scenario.model, rng)


@cache
def monte_carlo(method: Method, scenario: Scenario, replications: int) -> list[Estimate]:
    return [fit_of(method, scenario, i) for i in range(replications)]


@cache
def population_fits(method: Method, name: str, count: int) -> list[tuple[Scenario, Estimate]]:
    """Fits of recordings of pilots drawn at random, with their scenarios."""
    fits = []
    for replication in range(count):
        scenario = POPULATIONS[name].drawn(start_rng(7, name, replication))
        fits.append((scenario, fit_of(method, scenario, replication, seed=7)))
    return fits


def population_scores(fits: list[tuple[Scenario, Estimate]]) -> tuple[float, FloatArray]:
    """Coverage of the converged, and their errors over the claimed ones."""
    used = [(s.values, e) for s, e in fits if e.outcome is Outcome.CONVERGED]
    inside = [(e.intervals[:, 0] <= truth) & (truth <= e.intervals[:, 1]) for truth, e in used]
    errors = [(e.values - truth) / e.std_error for truth, e in used]
    return float(np.mean(np.concatenate(inside))), np.concatenate(errors)


def part_of(
    recording: Recording, runs: slice = slice(None), samples: slice = slice(None)
) -> Recording:
    """Some of a recording's runs, and of their samples, run-in included."""
    return recording.with_arrays({n: s[runs, samples] for n, s in recording.arrays.items()})


def leading_recording(lead: float = 0.2) -> Recording:
    """A control that runs ahead of the error, which no delay of a pilot explains.

    The control is half of what the error will be after `lead` [s], in six slow sines and
    without remnant, so that every estimator is pulled far beyond a delay of zero.
    """
    dt, samples, run_in = 0.02, 4096, 400
    time = (np.arange(samples + run_in) - run_in) * dt
    lines = np.array([3, 5, 8, 11, 14, 17])
    omega, phases = 2.0 * np.pi * lines / (samples * dt), np.arange(lines.size) ** 2.0
    e, ahead = (np.sin(np.outer(t, omega) + phases).sum(axis=1) for t in (time, time + lead))
    return Recording(dt=dt, e=e[None], u=0.5 * ahead[None], x=-e[None], run_in=run_in)


def changing_half_way(scenario: Scenario, shares: dict[str, float], seed: int) -> Recording:
    """A recording of a pilot each of whose parameters jumps by twice a share, half-way."""
    halves = []
    for side in (-1.0, 1.0):
        pairs = zip(scenario.model.keys, scenario.truth, strict=True)
        truth = tuple(value * (1.0 + side * shares.get(key, 0.0)) for key, value in pairs)
        halves.append(simulate(replace(scenario, truth=truth), np.random.default_rng(seed)))
    first, second = halves
    late = first.time >= 0.5 * first.duration
    arrays = {name: np.where(late, second.arrays[name], s) for name, s in first.arrays.items()}
    return first.with_arrays(arrays)


def running_away(recording: Recording) -> Recording:
    """The recording with a growing oscillation of 3 rad/s in the control.

    It is three times as large as the control, so that a black box must see its pole; what the
    pilot did is still there, so that the other coefficients are determined as well.
    """
    growing = np.exp(0.2 * recording.time) * np.sin(3.0 * recording.time)
    growing *= 3.0 * np.std(recording.u) / np.std(growing)
    return replace(recording, u=recording.u + growing)


def rows_of(path: Path) -> list[dict[str, str]]:
    """The rows of a table."""
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def strict(text: str) -> Any:
    """JSON without the words for what is not a number, which the standard does not have."""

    def no_constant(word: str) -> None:
        raise AssertionError(f"{word} is not JSON")

    return json.loads(text, parse_constant=no_constant)


#: As in a shell's foreground: what a background job starts ignores interruptions.
PROGRAM = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from pilotid.cli.main import main
main()
"""


def python(*words: object, **more: Any) -> subprocess.CompletedProcess[str]:
    """What this Python does in a process of its own."""
    command = [sys.executable, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, **more)


@dataclass(frozen=True)
class Answer:
    """What a command left behind."""

    status: int
    out: str
    err: str


Run = Callable[..., Answer]


def predict_circular(recording: Recording, model: PilotModel) -> Prediction:
    """The exact prediction of a recording that is one whole period, without remnant.

    Such a recording has no edges: its transform is the steady state itself.  The model must not
    vary in time.
    """
    length, prediction = recording.samples, predict(recording, model)
    s = 2j * np.pi * np.fft.rfftfreq(length, recording.dt)
    return replace(
        prediction,
        s=s,
        spectra=tuple(
            channel.sign
            * np.fft.rfft(recording.window(recording.input(channel.on)))
            * s**channel.derivative
            for channel in model.channels
        ),
        control_spectrum=np.fft.rfft(recording.window(recording.u)),
        window=replace(prediction.window, length=length, first=0, scored=length),
        nuisance_poles=(),
    )


def plane(lower: float = -50.0, upper: float = 50.0) -> Box:
    """The bounds of two parameters on a linear scale."""
    return Box(np.full(2, lower), np.full(2, upper), np.zeros(2, dtype=bool))


def minima_at(values: FloatArray, cost: FloatArray, information: float = 1.0) -> Minima:
    """Ends of a search with some costs, of parameters that are known equally well."""
    gram = information * np.tile(np.eye(values.shape[1] + 1), (len(values), 1, 1))
    gram[:, -1, -1] = cost
    return Minima(values, np.ones(len(values), dtype=bool), gram, 0.0 * gram[:, :-1, :-1], 5)
