"""Whether gains and leads stay as they are throughout a recording.

Under a constant pilot the prediction errors are unrelated to what a gain or lead that steps at
some time would have made of the control.  The Jacobian by each, from that time on, is held
against them at the optimum of the constant model: a Lagrange multiplier test of a change at a
known time, of whose statistics over many times the largest counts (Andrews, Econometrica 61(4),
1993).  A constant pilot has no time of change, so that this is not chi-squared (Davies, Biometrika
74(1), 1987): the p-value is that of one time, times the number of times, which is what chance
gives at most (Bonferroni).  No changing model is fitted.

A slower change is seen as a step in its middle.  One of the delay or of the neuromuscular system
is seen as far as it looks like one of gain and lead, and so is what a wrong model leaves: the
test is of the model that it is made with.  People do vary: in several runs of 80 s together
changes of a fifth of a gain, which no fit need mind, are certain.  So a pilot is said to change
only where that is certain and large.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pilotid.likelihood.optimum import Optimum
from pilotid.model.factors import Polynomial
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.solve.covariance import covariance_of
from pilotid.support.limits import ESTIMATE
from pilotid.support.numbers import chi_squared_tail
from pilotid.support.types import FloatArray

#: Shares of the scored time at which a change may be.
PLACES = np.linspace(0.1, 0.9, 21).tolist()


@dataclass(frozen=True)
class Constancy:
    """A test for gains and leads that change.

    Attributes
    ----------
    keys
        The parameters that were tested together.
    statistic
        The largest of the statistics over times, each chi-squared with as many degrees of
        freedom as there are keys.
    time
        Where it is, from the start of the measurement window [s]; it means something only if
        the pilot changes.
    steps
        By how much each key is larger after that time, as a share of its constant value; to
        first order.
    p
        How often a constant pilot gives as much, at the most.
    """

    keys: tuple[str, ...]
    statistic: float
    time: float
    steps: tuple[float, ...]
    p: float

    @property
    def size(self) -> float:
        """The largest of the steps, without its sign."""
        return max(abs(step) for step in self.steps)

    def __str__(self) -> str:
        steps = zip(self.keys, self.steps, strict=True)
        return ", ".join(f"{key} by {100.0 * step:+.0f} %" for key, step in steps)


def constancy(found: Optimum, recording: Recording) -> Constancy | None:
    """The test for gains and leads that change.

    Parameters
    ----------
    found
        The optimum of a constant model.
    recording
        What was fitted.

    Returns
    -------
    Constancy or None
        None for a model that varies or has no gain, and where nothing can be told.
    """
    prediction = found.joint.prediction
    varying = may_vary(prediction.model)
    changes = score_of_changes(found.tested_rows, varying, PLACES) if varying else []
    if not changes:
        return None
    best = max(changes, key=lambda change: change.statistic)
    tail = chi_squared_tail(best.freedom, best.statistic)
    unscored = max(0.0, recording.lead_in - recording.run_in * recording.dt)
    return Constancy(
        keys=tuple(prediction.model.keys[i] for i in varying),
        statistic=best.statistic,
        steps=tuple((best.steps / found.pilot[varying]).tolist()),
        time=unscored + best.place * prediction.scored * prediction.dt,
        p=min(1.0, len(changes) * tail),
    )


def may_vary(model: PilotModel) -> list[int]:
    """Indices of a model's gains and leads; none of a model that varies already."""
    keys = {
        parameter.key
        for channel in model.channels
        for factor in channel.dynamics
        if isinstance(factor, Polynomial)
        for parameter in factor.parameters
    }
    return [] if model.changes else [i for i, key in enumerate(model.keys) if key in keys]


class Change(NamedTuple):
    """The score test of a change at one time.

    Attributes
    ----------
    place
        The time, as a share of the samples.
    statistic, freedom
        Chi-squared with so many degrees of freedom under constant parameters.
    steps
        By how much each parameter that may change is larger from then on, to first order.
    """

    place: float
    statistic: float
    freedom: int
    steps: FloatArray


def score_of_changes(
    rows: FloatArray, varying: Sequence[int], places: Sequence[float]
) -> list[Change]:
    """The score tests of changes in some parameters, one for each time.

    The score after a time has the covariance I2 - I2 I^-1 I2, with I2 the information after it
    and I that of the whole (Andrews, Econometrica 61(4), 1993).

    Parameters
    ----------
    rows
        Jacobian by pilot and remnant, and last the prediction error, all whitened, shape
        (parameters + 1, runs, samples).
    varying
        Which rows of the Jacobian are of parameters that may change.
    places
        When they may, as shares of the samples.

    Returns
    -------
    list of Change
        Empty where the information is singular.
    """
    size = np.sqrt(np.einsum("irt,irt->i", rows[:-1], rows[:-1]))
    if not np.all(size > 0.0):
        return []
    scaled = rows / np.append(size, 1.0)[:, None, None]
    # Sums over the samples after each time are sums over the stretches between times.
    samples = rows.shape[-1]
    ends = [*(math.floor(place * samples + 0.5) for place in places), samples]
    stretches = [
        np.tensordot(scaled[varying, :, begin:end], scaled[..., begin:end], ((1, 2), (1, 2)))
        for begin, end in pairwise(ends)
    ]
    tails = np.cumsum(stretches[::-1], axis=0)[::-1]
    jacobian, errors = scaled[:-1].reshape(len(size), -1), scaled[-1].ravel()
    inverse = covariance_of(jacobian @ jacobian.T, 1.0)
    if inverse is None:
        return []
    variance = float(errors @ errors) / (errors.size - len(size))
    # Directions that one part of the recording alone tells of cannot be tested, and are dropped.
    root = np.linalg.cholesky(inverse[np.ix_(varying, varying)])
    found = []
    for place, tail in zip(places, tails, strict=True):
        # What constant parameters, estimated along with it, make of a change is no sign of one.
        across, own = tail[:, :-1], tail[:, varying]
        score = tail[:, -1] - across @ (inverse @ (jacobian @ errors))
        covariance = root.T @ (own - across @ inverse @ across.T) @ root
        sizes, directions = np.linalg.eigh(0.5 * (covariance + covariance.T))
        told = sizes > ESTIMATE.shared_by_halves
        along = directions[:, told].T @ root.T @ score
        statistic = float(np.sum(along**2 / sizes[told])) / variance
        steps = root @ directions[:, told] @ (along / sizes[told]) / size[varying]
        found.append(Change(place, statistic, along.size, steps))
    return found
