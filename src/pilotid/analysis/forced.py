"""How well pilot models explain what the forcing functions made of the control.

At the lines of multisines the control is compared with what a model in its loop makes of the
forcing functions alone.  That judges the pilot and nothing else.  The likelihood of the whole
control does not: a channel on the output can also predict the control as the inverse of the
controlled element does, x = Hc (u + fd), with a likelihood beyond that of any pilot and
without a pilot in it; on recordings of people without motion such a fit has won by 1500 in
deviance while its simulated response explained nothing of the control.

People never follow a model to within the errors of twenty lines.  Misfits are therefore set
against that of the best candidate (a quasi-likelihood: Burnham & Anderson, *Model Selection
and Multimodel Inference*, 2nd ed., sec. 2.5), and against that of runs left out of the fit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pilotid.frequency.fourier_coefficients import Coefficients, coefficients_of
from pilotid.methods.fourier import Equations, Fourier
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.seeds import fit_rng
from pilotid.solve.least_squares import minimise, solve_linear
from pilotid.solve.search import search
from pilotid.types import FloatArray

ROUNDS = 8  # in which leakage and power are found anew
STARTS, REFINED = 48, 6


@dataclass(frozen=True, eq=False)
class Forced:
    """One model's account of a recording's lines.

    Attributes
    ----------
    model
        The pilot model.
    values
        Its parameters, shape (parameters,).
    misfit
        Chi-squared of the lines of all runs, averaged in phase.
    freedom
        Its degrees of freedom.
    left_out
        Chi-squared of each run's lines under what the other runs say, shape (runs,); empty
        where there is one run alone.
    """

    model: PilotModel
    values: FloatArray
    misfit: float
    freedom: int
    left_out: FloatArray

    @property
    def excess(self) -> float:
        """Chi-squared per degree of freedom; NaN where none is left."""
        return self.misfit / self.freedom if self.freedom > 0 else math.nan


def objection(recording: Recording, model: PilotModel) -> str | None:
    """Why the lines cannot judge a model, or None."""
    return Fourier().objection(recording, model)


def forced(recording: Recording, models: Sequence[PilotModel], seed: int) -> list[Forced]:
    """What the lines say of several models, in their order, with the same weights for all.

    Parameters
    ----------
    recording
        A recording whose lines can judge all of the models, see `objection`.
    models
        The models, at least one.
    seed
        Seed of the searches' random starts.
    """
    found: dict[str, tuple[Coefficients, FloatArray, FloatArray]] = {}
    for model in sorted(models, key=lambda m: len(m.parameters)):
        simpler = [(m, found[m.name][1]) for m in models if m.name in found]
        starts = [
            _widened(m, values, model) for m, values in simpler if set(m.keys) < set(model.keys)
        ]
        found[model.name] = _fitted(recording, model, starts, seed)
    fits = [found[model.name] for model in models]
    # The power of the remnant as the model has it that leaves the least.
    _, power = min(
        ((_misfit(c, m, v, p), p) for m, (c, v, p) in zip(models, fits, strict=True)),
        key=lambda entry: entry[0],
    )
    return [
        _account(coefficients, model, values, power)
        for model, (coefficients, values, _) in zip(models, fits, strict=True)
    ]


def _widened(simpler: PilotModel, values: FloatArray, model: PilotModel) -> FloatArray:
    """A start for a model from the optimum of one that has some of its parameters."""
    known = dict(zip(simpler.keys, values.tolist(), strict=True))
    return np.array([known.get(key, own) for key, own in zip(model.keys, model.start, strict=True)])


def _fitted(
    recording: Recording, model: PilotModel, starts: Sequence[FloatArray], seed: int
) -> tuple[Coefficients, FloatArray, FloatArray]:
    """A recording's coefficients, the model's parameters, and the power of the remnant."""
    usual = Fourier()
    coefficients = coefficients_of(recording, model, usual.neighbours, usual.trend)
    power = coefficients.power(coefficients.first_residuals())
    problem = Equations(coefficients, model, power)
    rng = fit_rng(seed, model.name)
    ends = search(problem.gram, model, rng, candidates=STARTS, refined=REFINED)
    if starts:
        points, _ = solve_linear(
            problem.gram(np.array(starts)), np.array(starts), model.linear, model.lower
        )
        more = minimise(problem.gram, points, model, tolerance=1e-3, iterations=16)
        ends = min((ends, more), key=lambda minima: float(minima.cost[0]))
    values = ends.values[0]
    for _ in range(ROUNDS):
        residuals = coefficients.residuals(model.response(coefficients.omega, values))
        power = coefficients.power(residuals)
        before, values = values, _minimised(coefficients, model, values, power)
        if np.all(np.abs(values - before) <= 1e-4 * np.abs(before)):
            break
    return coefficients, values, power


def _minimised(
    coefficients: Coefficients, model: PilotModel, values: FloatArray, power: FloatArray
) -> FloatArray:
    """Parameters whose response in the loop to the forcing functions alone fits best."""
    problem = Equations(coefficients, model, power, 1.0, values)
    return np.asarray(minimise(problem.gram, values[None], model, tolerance=1e-6).values[0])


def _misfit(
    coefficients: Coefficients, model: PilotModel, values: FloatArray, power: FloatArray
) -> float:
    problem = Equations(coefficients, model, power)
    return float(np.sum(problem.rows(values[None])[0, -1] ** 2))


def _account(
    coefficients: Coefficients, model: PilotModel, values: FloatArray, power: FloatArray
) -> Forced:
    values = _minimised(coefficients, model, values, power)
    runs = len(coefficients.control)
    left_out = []
    for run in range(runs) if runs > 1 else ():
        others = _of_runs(coefficients, [r for r in range(runs) if r != run])
        known = _minimised(others, model, values, power * runs / (runs - 1))
        left_out.append(_misfit(_of_runs(coefficients, [run]), model, known, power * runs))
    lines = 2 * coefficients.lines
    return Forced(
        model=model,
        values=values,
        misfit=_misfit(coefficients, model, values, power),
        freedom=lines - len(values),
        left_out=np.array(left_out),
    )


def _of_runs(coefficients: Coefficients, runs: list[int]) -> Coefficients:
    """The coefficients of some runs alone."""
    return replace(
        coefficients,
        control=coefficients.control[runs],
        inputs=coefficients.inputs[:, runs],
        phases=coefficients.phases[runs],
    )
