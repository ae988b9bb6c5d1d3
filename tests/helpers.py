"""What several test files share: scenarios, recordings and parts of them, fits, strict JSON."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from pilotid.datasets import POPULATIONS, SCENARIOS, Scenario, simulate
from pilotid.estimate.estimate import Estimate, Outcome
from pilotid.estimate.method import Method, identify
from pilotid.likelihood.prediction import Prediction, predict
from pilotid.model.catalogue import MODELS
from pilotid.model.element import (
    double_integrator,
    element_named,
    integrator_with_lag,
    single_integrator,
)
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.solve.least_squares import Minima
from pilotid.support.numbers import fit_rng, recording_rng, start_rng
from pilotid.support.types import FloatArray

NOMINAL = SCENARIOS["nominal"]
SINGLE_LOOP = SCENARIOS["single"]

#: What trained pilots flew in Pool, Harder and van Paassen (2016).
TRAINED = element_named("10.62(s+0.99)/(s(s^2+2.58s+7.61))")
#: A pilot of each model of the catalogue, in a stable loop, by the model's name.
PILOTS = {
    scenario.model.name: scenario
    for scenario in (
        SINGLE_LOOP,
        NOMINAL,
        replace(
            NOMINAL,
            name="gain",
            model=MODELS["gain"],
            truth=(0.8, 0.28, 12.0, 0.3),
            element=single_integrator(2.0),
        ),
        replace(
            NOMINAL,
            name="lead-lag",
            model=MODELS["lead-lag"],
            truth=(0.6, 1.0, 0.35, 0.28, 13.0, 0.35),
            element=single_integrator(2.0),
        ),
        replace(
            NOMINAL,
            name="rate",
            model=MODELS["rate"],
            truth=(0.35, 1.1, 0.27, 0.25, 0.18, 11.0, 0.4),
            element=double_integrator(4.0),
        ),
        replace(
            NOMINAL,
            name="lead-lag-motion",
            model=MODELS["lead-lag-motion"],
            truth=(0.7, 1.3, 0.4, 0.24, 0.3, 0.18, 12.0, 0.35),
            element=integrator_with_lag(4.0, 1.5),
        ),
        replace(
            NOMINAL,
            name="lead-lag-canals",
            model=MODELS["lead-lag-canals"],
            truth=(0.7, 1.3, 0.4, 0.24, 1.2, 0.18, 12.0, 0.35),
            element=integrator_with_lag(4.0, 1.5),
        ),
        replace(
            NOMINAL,
            name="lead2-lag",
            model=MODELS["lead2-lag"],
            truth=(0.8, 0.45, 0.8, 0.22, 13.0, 0.35),
            element=TRAINED,
        ),
        replace(
            NOMINAL,
            name="lead2-lag-motion",
            model=MODELS["lead2-lag-motion"],
            truth=(4.75 * 0.2865, 0.30, 0.95, 0.22, 3.00 * 0.2865, 0.19, 14.0, 0.30),
            element=TRAINED,
        ),
        replace(
            NOMINAL,
            name="crossover",
            model=MODELS["crossover"].with_element(single_integrator(2.0)),
            truth=(2.2, 0.35),
            element=single_integrator(2.0),
        ),
        replace(
            NOMINAL,
            name="precision",
            model=MODELS["precision"],
            truth=(3.0, 0.25, 1.1, 2.5, 8.0, 0.2, 12.0, 0.4),
            element=single_integrator(2.0),
        ),
        replace(
            NOMINAL,
            name="pursuit",
            model=MODELS["pursuit"],
            truth=(0.8, 0.35, 0.28, 0.35, 0.16, 0.23, 12.0, 0.35),
            element=single_integrator(2.0),
        ),
        replace(
            NOMINAL,
            name="preview",
            model=MODELS["preview"],
            truth=(0.3, 1.1, 0.26, 0.9, 0.25, 0.7, 0.06, 0.12, 0.3, 11.0, 0.35),
            element=integrator_with_lag(4.0, 1.5),
        ),
        replace(
            NOMINAL,
            name="look-ahead",
            model=MODELS["look-ahead"],
            truth=(1.2, 0.35, 1.1, 0.2, 0.2, 10.0, 0.4),
            element=single_integrator(1.2),
        ),
        replace(
            NOMINAL,
            name="following",
            model=MODELS["following"],
            truth=(0.95, 0.12, 0.21, 12.0, 0.5),
            element=element_named("1"),
        ),
    )
}


def without_remnant(scenario: Scenario) -> Scenario:
    """The scenario of a pilot who does what the model says and nothing else."""
    return replace(scenario, remnant=replace(scenario.remnant, level=0.0, level_is="gain"))


@cache
def recording_of(scenario: Scenario, replication: int = 0, seed: int = 1) -> Recording:
    """The recording that a study with this random seed makes of a replication."""
    return simulate(scenario, recording_rng(seed, scenario.name, replication))


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


def strict(text: str) -> Any:
    """JSON without the words for what is not a number, which the standard does not have."""

    def no_constant(word: str) -> None:
        raise AssertionError(f"{word} is not JSON")

    return json.loads(text, parse_constant=no_constant)


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
    length = recording.samples
    s = 2j * np.pi * np.fft.rfftfreq(length, recording.dt)
    return replace(
        predict(recording, model),
        s=s,
        spectra=tuple(
            channel.sign
            * np.fft.rfft(recording.window(recording.input(channel.on)))
            * s**channel.derivative
            for channel in model.channels
        ),
        control_spectrum=np.fft.rfft(recording.window(recording.u)),
        length=length,
        first=0,
        scored=length,
        nuisance_poles=(),
    )


def minima_at(values: FloatArray, cost: FloatArray, information: float = 1.0) -> Minima:
    """Ends of a search with some costs, of parameters that are known equally well."""
    gram = information * np.tile(np.eye(values.shape[1] + 1), (len(values), 1, 1))
    gram[:, -1, -1] = cost
    return Minima(values, np.ones(len(values), dtype=bool), gram, 0.0 * gram[:, :-1, :-1], 5)
