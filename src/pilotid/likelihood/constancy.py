"""Whether gains and leads stay as they are throughout a recording.

Under a constant pilot the prediction errors are unrelated to what a gain or lead that steps at
some time would have made of the control.  The Jacobian by each, from that time on, is held
against them at the optimum of the constant model: a Lagrange multiplier test of a change at a
known time, of whose statistics over many times the largest counts (Andrews, Econometrica 61(4),
1993).  A constant pilot has no time of change, so that this is not chi-squared (Davies, Biometrika
74(1), 1987); but the scores of all times are jointly normal with a covariance that the
information tells, and draws from that say what chance gives.  No changing model is fitted.

A slower change is seen as a step in its middle.  One of the delay or of the neuromuscular system
is seen as far as it looks like one of gain and lead, and so is what a wrong model leaves: the
test is of the model that it is made with.  People do vary: in several runs of 80 s together
changes of a fifth of a gain, which no fit need mind, are certain.  So a pilot is said to change
only where that is certain and large.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pilotid.likelihood.optimum import Optimum
from pilotid.model.factors import Polynomial
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.solve.covariance import SINGULAR, covariance_of
from pilotid.support.limits import ESTIMATE
from pilotid.support.numbers import chi_squared_tail
from pilotid.support.types import FloatArray

#: Shares of the scored time at which a change may be.
PLACES = np.linspace(0.1, 0.9, 21)
#: Draws of the largest statistic under a constant pilot.
DRAWS = 4_000


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
        How often a constant pilot gives as much.
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


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of changes at several times, whitened for each time.

    Attributes
    ----------
    statistics
        Chi-squared at each time, shape (times,).
    whitener
        By which the scores of each time become independent and of variance one, shape
        (times, keys, keys).
    across
        Covariance of the scores of each time with those of constant parameters, shape
        (times, keys, parameters).
    own
        Covariance of the scores of each time, were the constant parameters known, shape
        (times, keys, keys).
    inverse
        Inverse of the information of the constant parameters.
    steps
        The changes that explain most at the time of the largest, shape (keys,).
    """

    statistics: FloatArray
    whitener: FloatArray
    across: FloatArray
    own: FloatArray
    inverse: FloatArray
    steps: FloatArray

    @property
    def factor(self) -> FloatArray:
        """A factor F of the scores' covariance F F', shape (times * keys, rank)."""
        times = np.arange(len(self.statistics))
        # What two changes have in common is what comes after the later one.
        both = self.own[np.maximum.outer(times, times)].transpose(0, 2, 1, 3)
        common = (self.across @ self.inverse).reshape(both.shape[0] * both.shape[1], -1)
        flat = self.across.reshape(common.shape)
        every = both - (common @ flat.T).reshape(both.shape)
        whitened = np.einsum("kia,kilj,ljb->kalb", self.whitener, every, self.whitener)
        eigenvalues, vectors = np.linalg.eigh(whitened.reshape(len(flat), -1))
        kept = eigenvalues > 1e-9 * eigenvalues[-1]
        return np.asarray(vectors[:, kept] * np.sqrt(eigenvalues[kept]))

    @property
    def bound(self) -> float:
        """What the chance of so large a statistic is at most, each time counted by itself."""
        tail = chi_squared_tail(self.steps.size, float(self.statistics.max()))
        return min(1.0, len(self.statistics) * tail)

    def chance(self, rng: np.random.Generator) -> float:
        """How often a constant pilot gives so large a statistic; `rng` draws what chance gives."""
        factor = self.factor
        drawn = rng.standard_normal((DRAWS, factor.shape[1])) @ factor.T
        squares = np.sum(drawn.reshape(DRAWS, len(self.statistics), -1) ** 2, axis=2)
        beyond = int(np.count_nonzero(squares.max(axis=1) >= self.statistics.max()))
        return min((beyond + 1.0) / (DRAWS + 1.0), self.bound)


def changes(p: float, size: float) -> bool:
    """Whether a pilot is said to change, by the chance and the largest share of a change."""
    return p < ESTIMATE.changes and size >= ESTIMATE.changes_by


def constancy(
    found: Optimum, recording: Recording, rng: np.random.Generator | None = None
) -> Constancy | None:
    """Test whether gains and leads are constant.

    Parameters
    ----------
    found
        The optimum of a constant model.
    recording
        What was fitted.
    rng
        Draws what chance gives; None to say what it gives at most.

    Returns
    -------
    Constancy or None
        None for a model that varies or has no gain, and where nothing can be told.
    """
    prediction = found.joint.prediction
    varying = may_vary(prediction.model)
    scores = change_scores(found.tested_rows, varying) if varying else None
    if scores is None:
        return None
    best = int(np.argmax(scores.statistics))
    unscored = max(0.0, recording.lead_in - recording.run_in * recording.dt)
    return Constancy(
        keys=tuple(prediction.model.keys[i] for i in varying),
        statistic=float(scores.statistics[best]),
        steps=tuple((scores.steps / found.pilot[varying]).tolist()),
        time=unscored + float(PLACES[best]) * prediction.scored * prediction.dt,
        p=scores.bound if rng is None else scores.chance(rng),
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


def change_scores(
    rows: FloatArray, varying: list[int], places: FloatArray = PLACES
) -> Scores | None:
    """Scores of changes in some parameters at several times.

    Parameters
    ----------
    rows
        Jacobian by pilot and remnant, and last the prediction error, all whitened, shape
        (parameters + 1, runs, samples).
    varying
        Which rows of the Jacobian are of parameters that may change.
    places
        When they may, as shares of the samples, shape (times,).

    Returns
    -------
    Scores or None
        None where the information is singular.
    """
    power = np.einsum("irt,irt->i", rows, rows)
    size = np.sqrt(power[:-1])
    if not np.all(size > 0.0):
        return None
    scaled = rows / np.append(size, 1.0)[:, None, None]
    # Sums over the samples after each time are sums over the stretches between times.
    after = np.floor(places * rows.shape[-1] + 0.5).astype(int)
    ends = [*after, rows.shape[-1]]
    stretches = [
        np.tensordot(scaled[varying, :, begin:end], scaled[..., begin:end], ((1, 2), (1, 2)))
        for begin, end in pairwise(ends)
    ]
    tails = np.cumsum(stretches[::-1], axis=0)[::-1]
    jacobian = scaled[:-1].reshape(len(size), -1)
    errors = scaled[-1].ravel()
    inverse = covariance_of(jacobian @ jacobian.T, 1.0)
    if inverse is None:
        return None
    # What constant parameters, estimated along with it, make of a change is no sign of one.
    across, own = tails[:, :, :-1], tails[:, :, varying]
    score = tails[:, :, -1] - across @ (inverse @ (jacobian @ errors))
    spread, directions = np.linalg.eigh(own - across @ inverse @ across.transpose(0, 2, 1))
    if np.any(spread[:, 0] <= SINGULAR):
        return None
    whitener = directions / np.sqrt(spread)[:, None, :]
    whitened = (score[:, None] @ whitener)[:, 0]
    variance = float(errors @ errors) / (errors.size - len(size))
    statistics = np.sum(whitened**2, axis=1) / variance
    best = int(np.argmax(statistics))
    steps = (whitener[best] @ whitened[best]) / size[varying]
    return Scores(statistics, whitener, across, own, inverse, steps)
