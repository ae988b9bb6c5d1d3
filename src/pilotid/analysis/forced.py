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

from pilotid.lines.coefficients import Coefficients
from pilotid.lines.fit import LinesFit, fit_lines
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.seeds import fit_rng
from pilotid.types import FloatArray


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


def forced(recording: Recording, models: Sequence[PilotModel], seed: int) -> list[Forced]:
    """What the lines say of several models, in their order, with the same weights for all.

    Parameters
    ----------
    recording
        A recording whose lines can judge all of the models, see
        `pilotid.estimates.applicability.lines_objection`.
    models
        The models, at least one.
    seed
        Seed of the searches' random starts.
    """
    found: dict[str, LinesFit] = {}
    for model in sorted(models, key=lambda m: len(m.parameters)):
        starts = [
            _widened(simpler, model)
            for simpler in found.values()
            if set(simpler.model.keys) < set(model.keys)
        ]
        rng = fit_rng(seed, model.name)
        found[model.name] = fit_lines(recording, model, rng, starts=starts)
    fits = [found[model.name] for model in models]
    # The power of the remnant as the model has it that leaves the least.
    power = min(fits, key=lambda fit: fit.misfit).power
    return [_account(replace(fit, power=power)) for fit in fits]


def _widened(simpler: LinesFit, model: PilotModel) -> FloatArray:
    """A start for a model from the optimum of one that has some of its parameters."""
    known = dict(zip(simpler.model.keys, simpler.values.tolist(), strict=True))
    return np.array([known.get(key, own) for key, own in zip(model.keys, model.start, strict=True)])


def _account(fit: LinesFit) -> Forced:
    fit = fit.minimised()
    coefficients = fit.coefficients
    runs = len(coefficients.control)
    left_out = []
    for run in range(runs) if runs > 1 else ():
        others = replace(
            fit,
            coefficients=_of_runs(coefficients, [r for r in range(runs) if r != run]),
            power=fit.power * runs / (runs - 1),
        )
        alone = replace(fit, coefficients=_of_runs(coefficients, [run]), power=fit.power * runs)
        left_out.append(float(alone.misfits(others.minimised().values[None])[0]))
    return Forced(
        model=fit.model,
        values=fit.values,
        misfit=fit.misfit,
        freedom=fit.freedom,
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
