"""Autoregressive model with external inputs (ARX), then the pilot model fitted to it.

Step one is linear least squares on decimated signals,

    A(q) u(t) = sum_i B_i(q) q^-n_i input_i(t) + w(t),

with one A for all channels, as Nieuwenhuizen, Zaal, Mulder, van Paassen and Mulder do (JGCD
31(4), 2008).  Orders and delays are searched on a grid by an information criterion.  Step two
fits the pilot model to the responses B_i/A, weighted by their covariance.

The structure that such a search settles for is biased, whatever the criterion: the remnant is
w/A, so that A has to serve the poles of both.  On scenario `nominal` Kvest is 13 % low and dnm
17 % high, on `single` tdvis 7 % and fnm 12 % high.  So the model used is long: from the
shortest delay on, polynomials that hold any remnant and any pilot.  Step two then reduces
it, which is efficient since it weighs them by their full covariance (Wahlberg, IEEE Trans.
AC 34(1), 1989), and all these biases fall below 1 %.  The search is kept for its
criterion surface, and `ARX(memory=None)` is the method with the structure found.

Three things that decide over success:

- Errors are propagated at the fitted pilot's response, in a few rounds.  At the estimated one
  a response that happens to be small looks accurate; 59 % of the intervals of Kvis cover then.
- Known dynamics (canals) filter the input.  Without that the slow pole is missed, and
  Kvest is 60 % low.
- Lags below the shortest delay (0.2 s) are left out.  Where no forcing function excites the
  loop, what the inputs tell of the control is the inverse of the controlled element, since e
  and x carry no noise of their own; a lag of one sample lets a regression find it.

No structure holds every pilot: delays may be shorter, lags longer than the memory.  What that
does to the estimate, the recording tells (`pilotid.likelihood.second_step`): errors hold how far
prediction errors move it, and one that they move by five claimed errors is refused.
Shorter lags, finer sampling, more poles and a longer memory, on pilots drawn at random, did not
make up for it.  With delays below .2 s intervals are too short; lags from .1 s
and a second step that ends where forcing functions do cover more (docs/measurements.md).

Assumes at least as many forcing functions as signals that the channels act on, and a
controlled element that is no mere gain.

Use it as a second opinion on delays, vestibular gain and neuromuscular parameters, without a
model of the remnant.

Do not use it for Kvis and tlead, which a memory of 1.4 s tells apart less well than `mle` does.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from pilotid.estimate.estimate import Estimate, Outcome, failed
from pilotid.estimate.quantities import FrequencyResponse
from pilotid.estimate.warnings import black_box_objection, is_absent
from pilotid.likelihood.prediction import Prediction, predict
from pilotid.likelihood.second_step import ResponseFit, against_recording, second_step
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.solve.least_squares import minimise, search
from pilotid.spectral.regression import Regression, Structure, channel_response
from pilotid.support.limits import ESTIMATE
from pilotid.support.numbers import chi_squared_limit
from pilotid.support.remarks import Remark
from pilotid.support.types import FloatArray

#: Of 49 such fits 20 were off by more than four claimed errors (one channel, 82 s, 25 to 1000 Hz).
FED_BACK = (
    "without a target, a regression does not tell the pilot from what the loop feeds back of the "
    "remnant: compare with mle or fourier"
)
MIN_ROWS = 5.0  # rows of the regression for each of its coefficients


@dataclass(frozen=True)
class ARX:
    """Least squares on lagged signals, and a pilot model fitted to the response.

    Attributes
    ----------
    band
        Analysis band [rad/s], which sets the sampling interval.
    poles, zeros
        Degrees of A, and numbers of coefficients of the B_i, that are searched; all inputs
        have the same number.
    delays
        Shortest and longest delay searched, for each input on its own [s]; the model used
        begins at the shortest.
    memory
        Longest lag of the inputs in the model used [s]; None uses the structure found
        as it is.  Longer ones come closer to the inverse of the controlled element.
    long_poles
        Degree of A in the model used.
    misfit
        Error of the black-box model as a share of the response, independent at every
        frequency; it adds to the covariance.
    lowest, highest, points
        Frequencies of the second step [rad/s], equally spaced on a logarithmic scale.  Where
        forcing functions end below the highest, an unstable pole between them refuses fits.
    rounds
        How often the covariance is propagated anew.
    """

    band: float = 26.0
    poles: tuple[int, ...] = (2, 3, 4, 5)
    zeros: tuple[int, ...] = (2, 3, 4, 5)
    delays: tuple[float, float] = (0.2, 0.6)
    memory: float | None = 1.5
    long_poles: int = 8
    misfit: float = 0.03
    lowest: float = 0.3
    highest: float = 18.0
    points: int = 24
    rounds: int = 3
    name: ClassVar[str] = "arx"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """Why least squares cannot tell the pilot: no forcing function, or an output at once."""
        if unsuited := black_box_objection(recording, model):
            return unsuited
        inputs = {c.on for c in model.channels} - {*model.extra}
        still = recording.fd is not None and is_absent(recording, recording.fd, recording.u)
        if len(inputs) > 1 and still:
            return (
                f"the channels of model {model.name} act on {len(inputs)} signals, which takes as "
                "many forcing functions, and there is no disturbance"
            )
        return None

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Fit a long ARX model, and the pilot model to its response.

        Parameters
        ----------
        recording
            The recording; the rows of all its runs are stacked.
        model
            The pilot model, whose start is one of the starts of the second step.
        rng
            Draws the other starts.
        """
        prediction = predict(recording, model, self.band)
        dt = prediction.dt
        regression, used = self._first_step(prediction)
        if regression.samples < MIN_ROWS * used.parameters:
            return failed(
                self.name,
                model,
                Outcome.NOT_APPLICABLE,
                f"{regression.samples} samples in the analysis band are too few for "
                f"{used.parameters} coefficients; use a longer recording or more runs",
            )
        black_box = regression.fit(used)
        omega = np.geomspace(self.lowest, min(self.highest, 0.75 * math.pi / dt), self.points)
        outside = black_box.poles[np.abs(black_box.poles) >= 1.0]
        unstable = np.min(np.abs(np.angle(outside)), initial=np.inf) / dt
        # Beyond the forcing functions closed-loop data fix A and B no further than their
        # sum in the loop; poles there say nothing about the pilot.
        if unstable < omega[-1]:
            return failed(
                self.name,
                model,
                Outcome.UNSTABLE_MODEL,
                f"the ARX model has an unstable pole at {unstable:.3g} rad/s",
            )
        delays = " and ".join(f"{d * dt:.2f} s" for d in used.delays)
        zeros = " + ".join(str(z) for z in used.zeros)
        note = f"ARX of {used.poles} and {zeros} coefficients, first lags {delays}"

        def response(at: FloatArray | None) -> FrequencyResponse:
            """The response with errors propagated at these parameters, shape (1, parameters)."""
            values = None if at is None else at[0]
            return channel_response(model, omega, dt, black_box, self.misfit, note, values)

        best: FloatArray | None = None
        for _ in range(self.rounds - 1):
            gram = ResponseFit(response(best), model).gram
            if best is None:
                best = search(gram, model, rng, candidates=12, refined=4).values[:1]
            best = minimise(gram, best, model, tolerance=1e-5).values[:1]
        estimate = second_step(self.name, recording, model, response(best), rng, known=best)
        estimate = against_recording(estimate, prediction, rng)
        if not is_absent(recording, recording.e + recording.x, recording.e):
            return estimate
        return replace(
            estimate, remarks=(*estimate.remarks, Remark("inseparable", FED_BACK, "doubt"))
        )

    def _first_step(self, prediction: Prediction) -> tuple[Regression, Structure]:
        """The lags of all signals, and the structure that is used."""
        dt, inputs = prediction.dt, len(prediction.model.channels)
        low = max(1, math.ceil(self.delays[0] / dt - 1e-9))
        if self.memory is not None:
            longest = max(low, math.floor(self.memory / dt + 1e-9))
            long = Structure(self.long_poles, (longest - low + 1,) * inputs, (low,) * inputs)
            return _regression(prediction, long), long
        high = max(low, math.floor(self.delays[1] / dt + 1e-9))
        lags = high + max(self.zeros) - low
        widest = Structure(max(self.poles), (lags,) * inputs, (low,) * inputs)
        regression = _regression(prediction, widest)
        structures = [
            Structure(p, (z,) * inputs, delays)
            for p in self.poles
            for z in self.zeros
            for delays in itertools.product(range(low, high + 1), repeat=inputs)
        ]
        return regression, regression.best(structures, 3.0)


def _regression(prediction: Prediction, widest: Structure) -> Regression:
    """The regression with those nuisance terms that the recording shows."""
    first = prediction.window.first
    output = prediction.samples_before(prediction.control_spectrum, first)
    inputs = [prediction.samples_before(signal, first) for signal in prediction.inputs]
    count = len(prediction.nuisance_poles)

    def regression(terms: int) -> Regression:
        nuisance = prediction.nuisance_terms[:, :terms]
        return Regression(output, inputs, widest, first, nuisance)

    full = regression(count)
    cost = full.cost(widest)
    variance = cost / max(1, full.samples - widest.parameters)
    for terms, smaller in enumerate(map(regression, range(count))):
        limit = chi_squared_limit(prediction.runs * (count - terms), ESTIMATE.seldom)
        if smaller.cost(widest) - cost <= limit * variance:
            return smaller
    return full
