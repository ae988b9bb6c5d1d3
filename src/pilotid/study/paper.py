"""The paper's numbers, and simulations in place of its recordings of people.

Berger, Zaal, Mulder and van Paassen, *Time Domain Pilot Model Identification Using Maximum
Likelihood Estimation*, AIAA 2008-7109.  Its numbers stand beside ours for comparison; nothing is
tuned to them.  The recordings of its Figs 9 to 11 are not public: `trials` simulates as many
subjects in as many conditions, and adds published recordings of people who turn with and without
motion, where they were fetched.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.datasets import SCENARIOS, Scenario, simulate
from pilotid.datasets.named import folder_of, recordings_in
from pilotid.datasets.scenarios import PILOT_AT_REST, PILOT_IN_MOTION
from pilotid.estimate.method import identify
from pilotid.estimate.quantities import Quantity
from pilotid.methods import method_named
from pilotid.model.catalogue import MULTI, SINGLE
from pilotid.model.loops import is_stable
from pilotid.model.model import PilotModel
from pilotid.recording.files import load_recording
from pilotid.support.jobs import Loss, run_tasks
from pilotid.support.numbers import draw_rng, fit_rng, recording_rng
from pilotid.support.types import FloatArray

if TYPE_CHECKING:
    from pandas import DataFrame

#: Order of the paper's numbers.
KEYS = ("Kvis", "tlead", "tdvis", "Kvest", "tdvest", "fnm", "dnm")
#: Fig. 3: bias and standard deviation [%] of 10 runs.
BIAS = (10.8, -4.6, -2.6, -11.6, 16.0, -3.4, -9.2)
DEVIATION = (44.0, 51.0, 3.1, 18.0, 5.7, 6.5, 4.4)
#: Fig. 5: error of the estimates of one recording, in the parameters' units.
FIGURE_5 = (0.0144, -0.209, -0.00283, -0.377, 0.0482, -0.575, -0.0416)
#: Table 3: bias [%] by scenario.
TABLE_3 = {
    "nominal": (12.37, -13.32, -3.63, -10.50, 15.88, -3.76, -9.67),
    "disturbance-only": (-6.28, -27.20, 406.72, 41.26, 144.95, -3.59, -17.14),
    "target-only": (8.97, -40.16, -5.81, -10.89, 38.50, -11.90, -35.51),
    "disturbance-step": (0.97, -1.29, 15.12, -3.82, 19.36, 1.70, -33.60),
    "target-step": (12.61, -7.68, 0.38, -2.58, 7.81, -0.81, -9.29),
}
REMNANTS = tuple(f"remnant-{gain / 10.0:.1f}" for gain in range(1, 9))
#: Fig. 9: which way each parameter goes from no motion to full motion.
FIGURE_9 = {"Kvis": "up", "tlead": "down", "tdvis": "down", "fnm": "up", "dnm": "up"}
METHODS = ("mmle3", "mle")

SUBJECTS, GROUPS = 5, 10
MOTION = {"no motion": 0.0, "reduced": 0.5, "full motion": 1.0}
#: Gain on motion with peripheral cues, over that without: the paper saw it rise, not by how much.
PERIPHERAL = {"central and motion": 1.0, "and peripheral": 1.25}
SCATTER = 0.1  # standard deviation between subjects, of logarithms
MARGIN = 1.15  # loops are stable still with a gain and a delay so much larger
#: Conditions of the experiment in yaw with one element, 15/s^2, without and with motion.
YAW = {"C3": "no motion", "C6": "full motion"}
PEOPLE = "people in yaw"


@dataclass(frozen=True)
class Trial:
    """A fit to do.

    Attributes
    ----------
    figure, subject, condition
        What it belongs to; subjects are numbered from 1.
    method, model
        What is fitted.
    source
        What is simulated, or the file of a recording.
    seed
        Seed of all random numbers.
    """

    figure: str
    subject: int
    condition: str
    method: str
    model: PilotModel
    source: Scenario | Path
    seed: int


def fit_trials(seed: int, workers: int | None) -> DataFrame:
    """All fits of Figs 9 to 11, a row for each parameter; failed ones have no value."""
    from pandas import DataFrame

    answers = run_tasks(fit_trial, [*trials(seed)], _given_up, workers)
    return DataFrame([row for rows in answers for row in rows])


def fit_trial(trial: Trial) -> list[dict[str, Any]]:
    """Simulate or read, and identify."""
    if isinstance(trial.source, Path):
        recording = load_recording(trial.source)
    else:
        recording = simulate(trial.source, recording_rng(trial.seed, trial.source.name))
    rng = fit_rng(trial.seed, trial.method)
    estimate = identify(method_named(trial.method), recording, trial.model, rng)
    return _rows(trial, estimate.parameters if estimate.outcome.usable else ())


def _given_up(trial: Trial, loss: Loss, why: str) -> list[dict[str, Any]]:
    return _rows(trial)


def _rows(trial: Trial, estimated: Iterable[Quantity] = ()) -> list[dict[str, Any]]:
    """A row for each parameter, which has no numbers if nothing was estimated."""
    names = ("figure", "subject", "condition", "method")
    front = {name: getattr(trial, name) for name in names}
    known = {q.key: {"value": q.value, "std_error": q.std_error} for q in estimated}
    nothing = {"value": np.nan, "std_error": np.nan}
    return [{**front, "parameter": key, **known.get(key, nothing)} for key in trial.model.keys]


def trials(seed: int) -> Iterator[Trial]:
    """What is fitted for Figs 9 to 11."""
    # A lumped fit: the pilot feels motion, and the model has the visual channel alone.
    motion = {condition: _pilot(share) for condition, share in MOTION.items()}
    cues = {condition: _pilot(1.0, more) for condition, more in PERIPHERAL.items()}
    for figure, base, model, count, pilots in (
        ("9", "disturbance-only", SINGLE, SUBJECTS, motion),
        ("10", "disturbance-only", MULTI, GROUPS, cues),
        ("11", "target-only", MULTI, GROUPS, cues),
    ):
        for subject in range(1, count + 1):
            subjects = _scattered([*pilots.values()], seed, subject)
            for condition, truth in zip(pilots, subjects, strict=True):
                name = f"fig-{figure}-{subject}-{condition}"
                source = replace(SCENARIOS[base], name=name, truth=truth)
                for method in METHODS:
                    yield Trial(figure, subject, condition, method, model, source, seed)
    for file in recordings_in(folder_of("yaw"), "yaw"):
        number, _, condition = file.stem.partition("subj")[2].partition("_")
        for method in METHODS if condition in YAW else ():
            yield Trial(PEOPLE, int(number), YAW[condition], method, SINGLE, file, seed)


def _pilot(share: float, vestibular: float = 1.0) -> FloatArray:
    """Between the paper's pilots at rest and in motion."""
    gain, lead, delay, *muscles = PILOT_AT_REST
    at_rest = np.array([gain, lead, delay, 1e-6, PILOT_IN_MOTION[4], *muscles])
    mixed = (1.0 - share) * at_rest + share * np.array(PILOT_IN_MOTION)
    mixed[3] *= vestibular
    return mixed


def _scattered(pilots: list[FloatArray], seed: int, subject: int) -> list[tuple[float, ...]]:
    """The pilots times what a subject has of his own, such that all loops are well stable."""
    rng, element = draw_rng(seed, "paper", subject), SCENARIOS["nominal"].element
    later = np.array([MARGIN if key in ("Kvis", "tdvis") else 1.0 for key in KEYS])
    while True:
        factors = np.exp(SCATTER * rng.standard_normal(len(KEYS)))
        scattered = [factors * pilot for pilot in pilots]
        if all(is_stable(MULTI, later * values, element) for values in scattered):
            return [tuple(values.tolist()) for values in scattered]
