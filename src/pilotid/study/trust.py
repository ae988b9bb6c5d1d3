"""How far a fit of one recording can be trusted: methods on simulations of this very recording.

The fit is taken for the truth, recordings like this one are simulated, and each method fits them: a
parametric bootstrap.  What it tells holds as far as the pilot is linear and the model right.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from pilotid.datasets import AnyScenario, Scenario
from pilotid.datasets.named import designed_scenario, scenario_json
from pilotid.estimate.estimate import Estimate
from pilotid.estimate.method import Method, identify
from pilotid.estimate.parts import Specification
from pilotid.methods import label_of, method_named, methods
from pilotid.model.catalogue import MODELS
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.study.judge import judge
from pilotid.study.scores import Mean
from pilotid.study.study import Bar, Study
from pilotid.study.table import Comparison
from pilotid.support.disk import make_folder, strict_json, write_file
from pilotid.support.numbers import DEFAULT_SEED, fit_rng
from pilotid.support.types import FloatArray, InputError

USUAL = "mle"  # fits the recording where nothing else is named, and makes the simulated pilot
COVERED = 0.95
TRUST = "trust.json"
#: What no simulation of a fit can tell.
UNKNOWN = (
    "This cannot know whether the pilot is linear and constant, and whether model and controlled "
    "element are right: what is wrong with them is wrong in the simulations too."
)


def length_factor(value: FloatArray, lower: FloatArray, upper: FloatArray, truth: float) -> float:
    """What lengths of 95 % intervals are to be multiplied by, so that 95 % hold the truth.

    Each interval needs a factor, by which it just reaches the truth when both sides are stretched
    from the value; of n the ceil(.95 (n + 1))-th smallest will do for 95 % of others.

    Parameters
    ----------
    value, lower, upper
        Values and ends of the intervals, shape (fits,).
    truth
        The true value.

    Returns
    -------
    float
        NaN with fewer than 19 intervals.
    """
    side = np.where(truth > value, upper - value, value - lower)
    known = np.isfinite(value) & ~np.isnan(side)
    missed, side = np.abs(truth - value)[known], side[known]
    place = math.ceil(COVERED * (missed.size + 1) - 1e-9)
    if place > missed.size:
        return math.nan
    with np.errstate(divide="ignore", invalid="ignore"):
        needed = np.where(missed == 0.0, 0.0, missed / np.maximum(side, 0.0))
    return float(np.sort(needed)[place - 1])


@dataclass(frozen=True)
class Trusted:
    """What simulations say of one parameter of a fit.

    Attributes
    ----------
    parameter, unit, value
        Key, unit, and value in the recording.
    interval_95, corrected_95
        The claimed interval, and the one whose length is multiplied by `factor`.
    bias, bias_claimed
        Mean error on simulations, in the parameter's unit and in claimed standard errors, each
        with its Monte Carlo error.
    coverage, coverage_95
        Share of the 95 % intervals that hold the truth on simulations, with its 95 % interval.
    factor
        See `length_factor`.
    """

    parameter: str
    unit: str
    value: float
    interval_95: tuple[float, float]
    corrected_95: tuple[float, float]
    bias: Mean
    bias_claimed: Mean
    coverage: float
    coverage_95: tuple[float, float]
    factor: float

    @property
    def is_off(self) -> bool:
        """Whether the coverage is not 95 %, beyond its Monte Carlo error."""
        low, high = self.coverage_95
        return low > COVERED or high < COVERED

    def sentence(self, method: str) -> str:
        """What to do about an interval whose coverage is off."""
        low, high = (100.0 * end for end in self.coverage_95)
        words = (
            f"{method}'s interval of {self.parameter} covers {100.0 * self.coverage:.0f} % here "
            f"({low:.0f} to {high:.0f} %)"
        )
        if math.isnan(self.factor):
            return f"{words}; more simulations tell what its length should be."
        if math.isinf(self.factor):
            return f"{words}, and no length mends it."
        return f"{words}: multiply its length by {self.factor:.2g}."


@dataclass(frozen=True, eq=False)
class Trial:
    """A fit that is to be tried on simulations of its recording.

    Attributes
    ----------
    recording
        Where the recording came from.
    estimate, label
        The fit of the recording, and the label of its method.
    scenario
        What is to be simulated.
    methods
        Those that the user named; none for all that apply.
    specification
        The test of the simulated fit against the forcing functions; None where there is none.
    """

    recording: str
    estimate: Estimate
    label: str
    scenario: Scenario
    methods: tuple[Method, ...]
    specification: Specification | None = None

    def run(
        self,
        folder: Path,
        replications: int,
        seed: int = DEFAULT_SEED,
        workers: int | None = None,
        bar: Bar = lambda results, _: results,
    ) -> Trust:
        """Simulate and fit in a folder, which holds the study and `trust.json` then.

        Parameters
        ----------
        folder
            Where; what was done there is not done again.
        replications, seed
            Simulations, and the seed of all random numbers.
        workers
            Processes; None for one for each processor.
        bar
            Shows results as they come: the results, and how many there will be by method.

        Raises
        ------
        InputError
            If the folder holds another trial.
        """
        make_folder(folder)
        path, known = folder / TRUST, MODELS.get(self.scenario.model.name) == self.scenario.model
        scenario: AnyScenario | str = self.scenario
        held: dict[str, object] = {"seed": seed}
        if known:  # otherwise no file can name the model
            held["scenario"] = scenario_json(self.scenario)
            if path.exists() and designed_scenario(path) != self.scenario:
                raise InputError(
                    f"{path}: is of another recording, model or method; name another folder "
                    "with --out"
                )
            write_file(path, strict_json(held).encode())
            scenario = str(path)
        tried = self.methods or list(methods().values())
        study = Study([scenario], tried, replications, seed)
        found = Trust(self, study.run_in(folder, workers, bar))
        found.comparison.write(folder)
        write_file(path, strict_json({**found.to_dict(), **held}).encode())
        return found


@dataclass(frozen=True, eq=False)
class Trust:
    """Methods compared on simulations of one recording.

    Attributes
    ----------
    trial
        The fit, and what was simulated.
    comparison
        All fits of the simulations.
    """

    trial: Trial
    comparison: Comparison

    @cached_property
    def parameters(self) -> tuple[Trusted, ...]:
        """What the simulations say of each parameter of the fit."""
        own = self.trial.scenario.name, self.trial.label
        fits, scores = self.comparison.cell(*own), self.comparison.scored(*own)
        if not len(scores):
            return ()
        found = []
        rows = list(scores.itertuples())[1:]
        for i, (q, row) in enumerate(zip(self.trial.estimate.parameters, rows, strict=True)):
            good = fits[fits.usable & (fits.parameter == q.key)]
            value, *ends = (good[name].to_numpy() for name in ("value", "low", "high"))
            factor = length_factor(value, ends[0], ends[1], row.truth)
            low = q.value - factor * (q.value - q.lower)
            high = q.value + factor * (q.upper - q.value)
            if math.isfinite(factor):  # no end lies outside the bounds of the search
                model = self.trial.estimate.model
                low, high = max(low, model.lower[i]), min(high, model.upper[i])
            found.append(
                Trusted(
                    q.key,
                    q.unit,
                    q.value,
                    (q.lower, q.upper),
                    (low, high),
                    Mean(row.bias, row.bias_se),
                    Mean(row.mean_z, row.mean_z_se),
                    row.coverage_95,
                    (row.coverage_lower, row.coverage_upper),
                    factor,
                )
            )
        return tuple(found)

    @property
    def sentences(self) -> list[str]:
        """What makes the simulations worthless, and each parameter whose coverage is off."""
        tested = self.trial.specification
        told = [p.sentence(self.trial.label) for p in self.parameters if p.is_off]
        if tested is None or tested.agrees:
            return told
        return [
            f"The fit that was simulated contradicts the forcing functions (p = "
            f"{tested.p_value:.1g}): the recorded pilot is another one than the simulated, and "
            "nothing that follows can be believed of it.",
            *told,
        ]

    def to_dict(self) -> dict[str, object]:
        """Plain objects, as `trust.json` has them, but for the scenario."""
        return {
            "recording": self.trial.recording,
            "model": self.trial.estimate.model.name,
            "method": self.trial.label,
            "replications": self.comparison.replications(self.trial.scenario.name),
            "parameters": {p.parameter: asdict(p) for p in self.parameters},
            "methods": {
                row.method: {
                    "loss": row.loss,
                    "loss_95": [row.loss_lower, row.loss_upper],
                    "coverage": row.coverage_95,
                    "verdict": judge(self.comparison.scored(row.scenario, row.method)).words,
                }
                for row in self.comparison.of(self.trial.scenario.name).itertuples()
            },
            "sentences": self.sentences,
            "unknown": UNKNOWN,
        }


def trial_of(
    recording: Recording,
    model: PilotModel,
    tried: Iterable[Method | str] = (),
    seed: int = DEFAULT_SEED,
) -> Trial:
    """Fit a recording, and make the scenario of the fit.

    The simulated pilot is that of the method whose fit is judged, or of ``mle`` if that method
    has no estimate of the remnant.

    Parameters
    ----------
    recording, model
        The recording, and the model to fit.
    tried
        Methods; the fit by the first is judged. None for all, and ``mle``.
    seed
        Seed of the fit.

    Raises
    ------
    InputError
        If the fit failed, or `Scenario.from_fit` refuses it.
    """
    named = tuple(method_named(m) if isinstance(m, str) else m for m in tried)
    first = named[0] if named else method_named(USUAL)
    label = label_of(first)
    estimate = identify(first, recording, model, fit_rng(seed, label))
    if not estimate.outcome.usable:
        raise InputError(f"{recording.source}: {label}: {estimate.sentence}; nothing to simulate")
    simulated = estimate
    if estimate.remnant is None:
        simulated = identify(method_named(USUAL), recording, model, fit_rng(seed, USUAL))
    scenario = Scenario.from_fit(simulated, recording)
    return Trial(recording.source, estimate, label, scenario, named, simulated.specification)
