"""Recursive ARX with forgetting, and a pilot model fitted to its response at each time.

The polynomials of A(q) u(t) = B(q) q^-n e(t) + w(t) are estimated by recursive least squares
in which a sample counts for less the longer ago it was, as H. A. van Grootheest, D. M. Pool,
M. M. van Paassen and M. Mulder do (AIAA 2018-0118).  The delay n is that of the best fit to all
of the recording; the published forgetting factor .99609 at 100 Hz is a memory of 2.56 s.  At each
time the pilot model with constant parameters is fitted to the response B/A, with the weight that
least squares claims for it; published is the reduction pole by pole, which comes to the same.
Signals are low-passed and decimated: at 100 Hz the equation's error is nearly all remnant beyond
the pilot, which A then describes.  A has two poles, and B three coefficients, one more than the
pilot with a delay of whole samples, which at this rate would cost a tenth of lead and delay.

A model's own parameters are fitted to the trajectory (`pilotid.time_domain.over_time`): those
of a constant one are weighted means over time.

Three things come with it.  A serves pilot and remnant, so that damping and lead are biased
by a remnant that is not white through 1/A.  What is estimated is what was some seconds ago.  And
a short memory scatters: the band says how far, for an equation error that is white.

Assumes an equation error that is white, and one channel on the error.

Use it to compare with work on that method.

Do not use it for results: use `mle` with a model that changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pilotid.estimates.estimate import Estimate, Outcome, failed
from pilotid.estimates.parts import Trajectory, times_of
from pilotid.frequency.regression import Regression, Structure, arx_response, lagged_rows
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.least_squares import LogTransform, minimise_each
from pilotid.solve.search import draw_starts
from pilotid.time_domain.over_time import estimated_over_time, no_reduction
from pilotid.time_domain.prepare import Prepared, prepare
from pilotid.types import ComplexArray, FloatArray, IntArray

#: Error of the response as a share of itself, independent at each frequency: two poles and two
#: coefficients are no delay and neuromuscular system.
MISFIT = 0.03
STARTS = 8  # random starts of the fit to the response over all of the recording
LEARNED = 0.5  # share of the memory that must be filled


@dataclass(frozen=True)
class RARX:
    """Recursive least squares on lagged signals, and the pilot at each time.

    Attributes
    ----------
    memory
        Time over which the weight of a sample falls to 1/e [s].
    band
        Analysis band [rad/s], which sets the sampling interval.
    poles, zeros
        Degree of A, and number of coefficients of B.
    delays
        Shortest and longest delay searched [s].
    lowest, highest, points
        Frequencies at which the pilot is fitted to the response [rad/s].
    """

    memory: float = 2.56
    band: float | None = 36.0
    poles: int = 2
    zeros: int = 3
    delays: tuple[float, float] = (0.1, 0.6)
    lowest: float = 0.4
    highest: float = 12.0
    points: int = 24
    name: ClassVar[str] = "rarx"
    follows: ClassVar[bool] = True
    libraries: ClassVar[tuple[str, ...]] = ("scipy.signal",)

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """Why it cannot treat a model: it has other channels than one on the error."""
        if len(model.channels) != 1 or model.channels[0].on != "e":
            return (
                f"model {model.name} is more than one channel on the error, and recursive ARX is "
                "of that alone; use mle, or fit a model such as single or adapting"
            )
        return no_reduction(model)

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Follow the polynomials over time, and reduce them to the pilot's parameters.

        Parameters
        ----------
        recording
            The recording; rows of all its runs count together at each time.
        model
            The pilot model, with parameters that change or without.
        rng
            Draws starts of the fit to the response.
        """
        plain = model.constant
        prepared = prepare(recording, plain, self.band, unscored=0.0)
        longest = max(1, math.floor(self.delays[1] / prepared.dt + 1e-9))
        first = max(self.poles, longest + self.zeros - 1)
        inputs = plain.channels[0].sign * prepared.inputs[0]
        shortest = min(longest, max(1, math.ceil(self.delays[0] / prepared.dt - 1e-9)))
        lags = [(shortest, longest + self.zeros - 1)]
        regression = Regression(prepared.control, [inputs], self.poles, lags, first)
        structures = [
            Structure(self.poles, (self.zeros,), (n,)) for n in range(shortest, longest + 1)
        ]
        if regression.samples < 5 * structures[0].parameters:
            words = f"{regression.samples} samples in the analysis band are too few"
            return failed(self.name, model, Outcome.NOT_APPLICABLE, words)
        structure = structures[int(np.argmin(regression.costs(structures)))]
        rows = lagged_rows(
            prepared.control - prepared.control.mean(),
            [inputs - inputs.mean()],
            self.poles,
            [(int(structure.lags(0)[0]), int(structure.lags(0)[-1]))],
            first,
        )
        time = times_of(recording.duration)
        trajectory = self._trajectory(prepared, rows, structure, plain, time, first, rng)
        if trajectory is None:
            return failed(self.name, model, Outcome.SINGULAR)
        return estimated_over_time(self.name, recording, model, trajectory, self.memory)

    def _trajectory(
        self,
        prepared: Prepared,
        rows: FloatArray,
        structure: Structure,
        plain: PilotModel,
        time: FloatArray,
        first: int,
        rng: np.random.Generator,
    ) -> Trajectory | None:
        """The parameters at each time; None where least squares is singular throughout."""
        factor = math.exp(-prepared.dt / self.memory)
        own = prepared.time[first:]
        at = np.searchsorted(own, time + 1e-9 * prepared.dt, side="right") - 1
        filled = 1.0 - factor ** (at + 1.0)
        known = np.flatnonzero((at >= 0) & (filled >= LEARNED))
        if not known.size:
            return None
        found = forgetting(rows, factor, at[known])
        if found is None:
            return None
        coefficients, covariance = found
        omega = np.geomspace(
            self.lowest, min(self.highest, 0.75 * np.pi / prepared.dt), self.points
        )
        response, slopes = arx_response(structure, coefficients, np.exp(-1j * omega * prepared.dt))
        fit = _Reduction(plain, omega, response[:, 0], slopes[:, :, 0], covariance)
        middle = fit.at_once(rng)
        values, error = fit.over_time(middle)
        ends = LogTransform(plain.positive).interval(values, error, plain.lower, plain.upper)
        parts = [np.full((len(plain.keys), time.size), np.nan) for _ in range(3)]
        for part, found_there in zip(parts, (values, *ends), strict=True):
            part[:, known] = found_there.T
        return Trajectory(plain.keys, time, *parts)


def forgetting(
    rows: FloatArray, factor: float, at: IntArray
) -> tuple[FloatArray, FloatArray] | None:
    """Least squares in which the weight of a row falls by a factor from each to the next.

    Parameters
    ----------
    rows
        Regressors and last the output, shape (runs, rows, columns).
    factor
        Of forgetting, below 1.
    at
        After which rows the coefficients are wanted, shape (times,).

    Returns
    -------
    Coefficients (times, columns - 1), and their covariances for white errors; None if there
    is a time at which they are not determined.
    """
    from scipy.signal import lfilter

    size = np.sqrt(np.mean(rows**2, axis=(0, 1)))
    size = np.where(size > 0.0, size, 1.0)
    scaled = rows / size
    count = rows.shape[-1]
    products = np.einsum("rti,rtj->tij", scaled, scaled).reshape(rows.shape[1], -1)

    def weighted(share: float) -> FloatArray:
        sums = lfilter([1.0], [1.0, -share], products, axis=0)[at]
        return np.asarray(sums).reshape(-1, count, count)

    sums, squares = weighted(factor), weighted(factor**2)
    ridge = 1e-10 * np.trace(sums[:, :-1, :-1], axis1=1, axis2=2)[:, None, None]
    try:
        inverse = np.linalg.inv(sums[:, :-1, :-1] + ridge * np.eye(count - 1))
    except np.linalg.LinAlgError:
        return None
    coefficients = (inverse @ sums[:, :-1, -1:])[:, :, 0]
    left = sums[:, -1, -1] - np.sum(coefficients * sums[:, :-1, -1], axis=1)
    weight = rows.shape[0] * (1.0 - factor ** (at + 1.0)) / (1.0 - factor)
    variance = np.mean(np.maximum(left, 0.0)) / np.mean(weight)
    covariance = variance * inverse @ squares[:, :-1, :-1] @ inverse
    unit = size[-1] / size[:-1]
    return coefficients * unit, covariance * unit[:, None] * unit


class _Reduction:
    """The pilot's parameters from the response of polynomials, at each time."""

    def __init__(
        self,
        plain: PilotModel,
        omega: FloatArray,
        response: ComplexArray,
        slopes: ComplexArray,
        covariance: FloatArray,
    ) -> None:
        self._plain, self._at, self._response = plain, plain.at(omega), response
        self._slopes, self._covariance = slopes, covariance
        spread = np.einsum("tif,tij,tjf->tf", slopes.conj(), covariance, slopes).real
        self._weight = 1.0 / np.sqrt(
            np.maximum(spread, 0.0) + (MISFIT * np.abs(response)) ** 2 + 1e-300
        )

    def _rows(self, values: FloatArray, which: IntArray) -> FloatArray:
        """Weighted Jacobian and residual, real parts behind imaginary ones."""
        rows = self._at(values)[:, 0]
        np.subtract(self._response[which], rows[:, -1], out=rows[:, -1])
        rows *= self._weight[which][:, None]
        return np.concatenate([rows.real, rows.imag], axis=-1)

    def _gram(self, values: FloatArray, which: IntArray) -> FloatArray:
        rows = self._rows(values, which)
        return np.asarray(rows @ rows.swapaxes(1, 2))

    def at_once(self, rng: np.random.Generator) -> FloatArray:
        """One pilot for the time in the middle of all responses, shape (parameters,)."""
        weight = self._weight**2
        mean = np.sum(weight * self._response, axis=0) / weight.sum(axis=0)
        near = np.argmin(np.sum(weight * np.abs(self._response - mean) ** 2, axis=1))
        starts = np.concatenate([self._plain.start[None], draw_starts(self._plain, rng, STARTS)])
        own = np.full(len(starts), near)
        end = minimise_each(lambda v, w: self._gram(v, own[w]), starts, self._plain, tolerance=1e-6)
        return np.asarray(end.values[np.argmin(end.cost)])

    def over_time(self, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values and standard errors, the latter on the logarithm of positive parameters."""
        plain, times = self._plain, len(self._response)
        starts = np.repeat(start[None], times, axis=0)
        end = minimise_each(self._gram, starts, plain, tolerance=1e-6, iterations=25)
        rows = self._rows(end.values, np.arange(times))
        scale = LogTransform(plain.positive)
        jacobian = rows[:, :-1] * scale.slope(end.values)[:, :, None]
        own = self._slopes * self._weight[:, None]
        moved = np.concatenate([own.real, own.imag], axis=-1)
        # What the response does not tell is known to lie within its bounds.
        prior = np.diag(1.0 / scale.unknown(plain.lower, plain.upper) ** 2)
        inverse = np.linalg.inv(jacobian @ jacobian.swapaxes(1, 2) + prior)
        gain = inverse @ (jacobian @ moved.swapaxes(1, 2))
        variance = np.einsum("tpi,tij,tpj->tp", gain, self._covariance, gain)
        left = np.einsum("tpq,qr,trp->tp", inverse, prior, inverse)
        return end.values, np.sqrt(np.maximum(variance, 0.0) + left)
