"""Maximum likelihood of a constant pilot in windows that slide over the recording.

The usual way to follow a pilot who changes: in each window one constant pilot, whose prediction
errors, whitened by the remnant's spectrum, are as small as can be.  The control is predicted from
all that came before, so that a window begins without a transient, and the remnant is the same in
all windows: an autoregression of what the pilots of all windows leave, each in the middle of its
own.  A window's values are put at its middle, those of the first and last also at the ends.

A model's own parameters are fitted to the trajectory (`pilotid.time_domain.over_time`): those
of a constant one are weighted means over time.

A change that takes less than a window is smeared over it, and a short window knows little: the
band is that of a pilot who was constant.

Assumes a pilot who is constant within a window, and a remnant that does not change.

Use it to see whether a pilot changes, and how, without saying so beforehand.

Do not use it for changes faster than a window, or where `mle` has a model that changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pilotid.estimates.estimate import Estimate, Outcome, failed
from pilotid.estimates.parts import Trajectory, times_of
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.least_squares import LogTransform, Minima, minimise_each
from pilotid.solve.search import search
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.over_time import estimated_over_time, no_reduction
from pilotid.time_domain.prediction import Prediction, predict, weighted
from pilotid.time_domain.prepare import analysis_band, prepare
from pilotid.time_domain.remnant_models import best_noise_model
from pilotid.types import BoolArray, FloatArray, IntArray

SHORTEST = 5.0  # seconds of a window
ROUNDS = 2  # of pilots and remnant in turn
AT_ONCE = 8  # windows whose prediction is made at once


@dataclass(frozen=True)
class MLEWindowed:
    """A constant pilot in each of many windows.

    Attributes
    ----------
    window, step
        Length of a window, and time from one to the next [s].
    band
        Analysis band [rad/s].
    candidates, refined
        Of the search over all of the recording, see `pilotid.solve.search.search`.
    """

    window: float = 20.0
    step: float = 2.0
    band: float | None = 36.0
    candidates: int = 8
    refined: int = 2
    name: ClassVar[str] = "mle-windowed"
    follows: ClassVar[bool] = True

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """Why it cannot treat a recording: it holds no window, or the model is not its kind."""
        if self.window < SHORTEST or self.step <= 0.0:
            return f"a window must last {SHORTEST:g} s at least, and the step be positive"
        if recording.duration < 1.5 * self.window:
            return (
                f"the recording lasts {recording.duration:.3g} s, less than one and a half windows "
                f"of {self.window:g} s; set window= or use mle"
            )
        return no_reduction(model)

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Fit a pilot to each window, and the model's parameters to their course.

        Parameters
        ----------
        recording
            The recording; all its runs are fitted jointly in each window.
        model
            The pilot model, with parameters that change or without.
        rng
            Draws starts of the search over all of the recording.
        """
        plain = model.constant
        prediction = weighted(predict(recording, plain, self.band), recording)
        time = prepare(recording, plain, self.band).scored_time
        length = min(self.window, time[-1] - time[0])
        count = 1 + max(1, math.floor((time[-1] - time[0] - length) / self.step + 1e-9))
        middles = np.linspace(time[0] + 0.5 * length, time[-1] - 0.5 * length, count)
        inside = np.abs(time - middles[:, None]) <= 0.5 * length
        windows = Windows(prediction, inside)
        whole = search(
            OutputErrors(prediction).gram,
            plain,
            rng,
            candidates=self.candidates,
            refined=self.refined,
        )
        starts = np.repeat(whole.values[:1], count, axis=0)
        band = analysis_band(recording.dt, self.band)
        nearest = np.argmin(np.abs(time - middles[:, None]), axis=0)
        left = windows.left(starts, nearest)
        for _ in range(ROUNDS):
            windows.taps = best_noise_model(left, band).whitener(band)
            end = minimise_each(windows.gram, starts, plain, tolerance=1e-6, iterations=40)
            starts = end.values
            left = windows.left(starts, nearest)
        found = self._trajectory(end, inside, plain, middles, times_of(recording.duration), windows)
        if found is None:
            return failed(self.name, model, Outcome.SINGULAR)
        return estimated_over_time(self.name, recording, model, found, 0.5 * length)

    def _trajectory(
        self,
        end: Minima,
        inside: BoolArray,
        plain: PilotModel,
        middles: FloatArray,
        time: FloatArray,
        windows: Windows,
    ) -> Trajectory | None:
        """Values and bands of the windows at all times; None where nothing is known."""
        scale, runs = LogTransform(plain.positive), windows.prediction.runs
        freedom = np.maximum(1.0, runs * inside.sum(axis=1) - len(plain.keys))
        variance = end.cost / freedom
        hessian = scale.inner(end.gram, end.values)[:, :-1, :-1]
        # What a window does not tell is known to lie within its bounds.
        span = scale.unknown(plain.lower, plain.upper)
        information = hessian / variance[:, None, None] + np.diag(1.0 / span**2)
        if not (np.isfinite(information).all() and (variance > 0.0).all()):
            return None
        variances = np.diagonal(np.linalg.inv(information), axis1=1, axis2=2)
        if not (variances > 0.0).all():  # a window's optimum is none
            return None
        error = np.sqrt(variances)
        parts = (end.values, *scale.interval(end.values, error, plain.lower, plain.upper))
        over = [np.array([np.interp(time, middles, row) for row in part.T]) for part in parts]
        return Trajectory(plain.keys, time, *over)


class Windows:
    """Prediction errors of constant pilots in windows of one recording.

    Parameters
    ----------
    prediction
        Of the whole recording.
    inside
        Which scored samples a window holds, shape (windows, samples).

    Attributes
    ----------
    taps
        Filter that whitens what is left, None for none.
    """

    def __init__(self, prediction: Prediction, inside: BoolArray) -> None:
        self.prediction, self._inside = prediction, inside
        self.taps: FloatArray | None = None

    def gram(self, values: FloatArray, which: IntArray) -> FloatArray:
        """Gram matrices of parameter sets, each in its window; see `Problem.gram`."""
        parts, terms = [], self.prediction.band_terms
        for begin in range(0, len(values), AT_ONCE):
            some = slice(begin, begin + AT_ONCE)
            rows = self.prediction.rows(values[some], self.taps)
            rows = self.prediction.without_nuisance(rows)
            if terms is not None:
                rows = terms.filtered(rows, 0.5)
            rows *= self._inside[which[some], None, None]
            flat = rows.reshape(*rows.shape[:2], -1)
            products = flat @ flat.transpose(0, 2, 1)
            if terms is not None:
                loop = self.prediction.loop.row_spectra(values[some])[:, :, 0]
                own = np.ones(1) if self.taps is None else self.taps
                taps = np.broadcast_to(own, (len(rows), own.size))
                none = np.zeros((len(rows), 0, taps.shape[1]))
                share = self._inside[which[some]].mean(axis=1)
                products = terms.closed(products, loop, taps, none, share)
            parts.append(products)
        return np.concatenate(parts)

    def left(self, values: FloatArray, nearest: IntArray) -> FloatArray:
        """What the pilots of all windows leave of the control, not whitened, (runs, samples).

        Parameters
        ----------
        values
            Parameters in each window, shape (windows, parameters).
        nearest
            The window of each sample, shape (samples,).
        """
        total = np.zeros((self.prediction.runs, self.prediction.scored))
        for i, own in enumerate(values):
            residual = self.prediction.without_nuisance(self.prediction.residual(own))
            total[:, nearest == i] = residual[:, nearest == i]
        return total
