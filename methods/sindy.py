"""Sparse regression of discrete dynamics (SINDy), then the pilot model fitted to it.

Step one regresses the control on lags of itself and of each channel's input, and prunes
the library by sequentially thresholded least squares: SINDy (Brunton, Proctor and Kutz,
PNAS 113, 2016) for a discrete system with inputs (Kaiser, Kutz and Brunton, Proc. R. Soc.
A 474, 2018), by pysindy's `STLSQ`.  An ensemble of the same fits on resampled blocks of time
(Fasel et al., Proc. R. Soc. A 478, 2022) says how far it scatters.  Step two fits the pilot
model to the frequency response of the sparse model.

What a pilot makes of the textbook's recipe:

- Delays lie on a grid outside the regression.  Lagged signals are nearly collinear, and
  thresholds take their pick among equals: they do not find a delay.
- No lag is below one sample.  The acceleration of a double integrator is a multiple of the
  control plus disturbance *at the same instant*; a regression that sees it finds the
  inverse of the controlled element.
- Known dynamics (canals) filter the input before the regression.  Left to it, their slow
  pole, within 0.02 of the unit circle, cost nine tenths of the vestibular gain.
- Thresholds apply to standardised columns and stay low.  A pilot with a coloured remnant
  is not sparse in lags: every term has its small share, and to prune more costs accuracy.
- The estimate is held against the recording, as that of `arx` is
  (`pilotid.likelihood.second_step`).

Assumes that the lags describe the remnant as well.  Two channels need two forcing functions, and
no black box can do with a controlled element that is a mere gain.

Use it to see what sparse regression makes of a pilot.

Do not use it for results, where `mle` is more accurate.
"""

from __future__ import annotations

import itertools
import math
import warnings
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pilotid.estimate.estimate import Estimate, Outcome, failed
from pilotid.estimate.quantities import FrequencyResponse
from pilotid.estimate.warnings import black_box_objection
from pilotid.likelihood.prediction import predict
from pilotid.likelihood.second_step import against_recording, second_step
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.spectral.regression import (
    BlackBox,
    Regression,
    Structure,
    channel_response,
    lagged_rows,
    triangle_of,
)
from pilotid.support.types import FloatArray

MIN_ROWS = 2.0  # rows of the regression for each of its columns
MIN_BLOCKS = 10  # blocks of time to resample from
VAGUE = 2.0  # errors of a response in units of its size, beyond which it says nothing


@dataclass(frozen=True)
class SINDy:
    """Sparse discrete-time regression by pysindy, and a pilot model fitted to its response.

    Attributes
    ----------
    band
        Analysis band [rad/s], which sets the sampling interval of the lags.
    own_lags
        Lags of the control in the library.
    memory
        Longest lag of an input in the library [s].
    longest_delay
        End of the grid of delays [s], which begins at one sampling interval.
    threshold
        Smallest coefficient kept, for columns and control of unit standard deviation.
    members, block
        Size of the ensemble, and length of the blocks of time that it resamples [s].
    misfit
        Error of the sparse model as a share of the response, independent at every
        frequency; it adds to the spread of the ensemble.
    lowest, highest, points
        Frequencies of the second step [rad/s], equally spaced on a logarithmic scale.
    """

    band: float = 26.0
    own_lags: int = 4
    memory: float = 1.4
    longest_delay: float = 0.4
    threshold: float = 0.05
    members: int = 20
    block: float = 1.0
    misfit: float = 0.05
    lowest: float = 0.4
    highest: float = 16.0
    points: int = 20
    name: ClassVar[str] = "sindy"
    libraries: ClassVar[tuple[str, ...]] = ("pysindy",)

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """Why no black box can tell the pilot: the inputs are one signal, or hold the control."""
        return black_box_objection(recording, model)

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Find a sparse model, and fit the pilot model to its response.

        Parameters
        ----------
        recording
            The recording; the rows of all its runs are stacked.
        model
            The pilot model, whose start is one of the starts of the second step.
        rng
            Resamples blocks of time, and draws the other starts.
        """
        library = Library(self, recording, model)
        structure = library.best_delays()
        if library.count < MIN_ROWS * structure.parameters:
            return failed(
                self.name,
                model,
                Outcome.NOT_APPLICABLE,
                f"{library.count} samples in the analysis band are too few for "
                f"{structure.parameters} candidate terms; use a longer recording or more runs",
            )
        sparse = self.regress(library, structure, rng)
        dt, count = library.dt, np.count_nonzero(sparse.coefficients)
        lowest = max(self.lowest, 2.0 * np.pi / recording.duration)
        omega = np.geomspace(lowest, min(self.highest, 0.9 * np.pi / dt), self.points)
        delays = " and ".join(f"{d * dt:.2f} s" for d in structure.delays)
        note = f"sparse model of {count} of {structure.parameters} terms, first lags {delays}"
        response = channel_response(model, omega, dt, sparse, self.misfit, note)
        if reason := unusable(sparse, model) or undetermined(response, model):
            return failed(self.name, model, Outcome.UNSTABLE_MODEL, reason)
        estimate = second_step(self.name, recording, model, response, rng)
        return against_recording(estimate, library.prediction, rng)

    def regress(self, library: Library, structure: Structure, rng: np.random.Generator) -> BlackBox:
        """The sparse model of one structure, with the covariance of its ensemble."""
        blocks = library.blocks(structure, self.block)
        triangle = triangle_of(np.concatenate(blocks))
        size = structure.parameters
        coefficients = prune(triangle, self.threshold)
        picked = rng.integers(len(blocks), size=(self.members, len(blocks)))
        resampled = [triangle_of(np.concatenate([blocks[i] for i in some])) for some in picked]
        members = np.array([prune(rows, self.threshold) for rows in resampled])
        cost = float(np.sum((triangle[:, -1] - triangle[:, :-1] @ coefficients) ** 2))
        variance = cost / (library.count - size)
        covariance = ensemble_covariance(members - coefficients, triangle[:size, :size], variance)
        return BlackBox(structure, coefficients, covariance)


class Library:
    """The candidate terms of a recording: signals on the analysis grid, and their lags."""

    def __init__(self, settings: SINDy, recording: Recording, model: PilotModel) -> None:
        self.prediction = prediction = predict(recording, model, settings.band)
        self.dt = prediction.dt
        reach = max(2, math.floor(settings.memory / self.dt + 1e-9))
        longest = max(1, math.floor(settings.longest_delay / self.dt + 1e-9))
        self._first = max(settings.own_lags, reach)
        self.control = prediction.samples_before(prediction.control_spectrum, self._first)
        inputs = prediction.inputs
        self.inputs = [prediction.samples_before(signal, self._first) for signal in inputs]
        self.count = prediction.runs * (prediction.window.scored - 1)
        # From the one that begins at one sample and has all lags.
        grid = range(1, min(longest, reach - 1) + 1)
        self._structures = [
            Structure(settings.own_lags, tuple(reach - d + 1 for d in delays), delays)
            for delays in itertools.product(grid, repeat=len(inputs))
        ]

    def best_delays(self) -> Structure:
        """The structure whose delays have the best Bayesian information criterion."""
        regression = Regression(self.control, self.inputs, self._structures[0], self._first)
        return regression.best(self._structures, 1.0)

    def blocks(self, structure: Structure, length: float) -> list[FloatArray]:
        """Triangular factors of blocks of rows, none of which spans two runs.

        A triangular factor stands for its rows: all inner products are the same.
        """
        rows = lagged_rows(self.control, self.inputs, structure, self._first)
        rows = rows - rows.mean(axis=1, keepdims=True)
        runs, samples, _ = rows.shape
        least = math.ceil(MIN_BLOCKS / runs)
        parts = min(max(least, round(samples * self.dt / length)), samples)
        return [triangle_of(part) for run in rows for part in np.array_split(run, parts)]


def prune(rows: FloatArray, threshold: float) -> FloatArray:
    """Coefficients of a regression, pruned by pysindy's thresholded least squares.

    Parameters
    ----------
    rows
        The library's columns, and last the target; shape (rows, terms + 1).
    threshold
        Smallest coefficient kept once all columns are scaled to one size.

    Returns
    -------
    Array of shape (terms,), zero where a term was pruned.
    """
    import pysindy
    import sklearn

    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0.0] = 1.0
    scaled = rows / scale
    # The default solver squares the condition of the library, which is 1e4 and more.
    optimizer = pysindy.STLSQ(threshold=threshold, alpha=0.0, ridge_kw={"solver": "svd"})
    # What scikit-learn looks for in its input, hundreds of times in a fit, cannot be there.
    unchecked = sklearn.config_context(assume_finite=True, skip_parameter_validation=True)
    with unchecked, warnings.catch_warnings():
        # It warns when nothing survives, which the caller looks at, and of an unsettled set.
        warnings.simplefilter("ignore")
        optimizer.fit(scaled[:, :-1], scaled[:, -1])
    return np.asarray(np.ravel(optimizer.coef_) * scale[-1] / scale[:-1])


def ensemble_covariance(
    deviations: FloatArray, triangle: FloatArray, variance: float
) -> FloatArray:
    """Covariance of coefficients from an ensemble of fewer members than it takes.

    Least squares gives the shape, and the ensemble its size: the factor by which the
    members scatter more widely, pruning included, and 1 at least.  The members' own sample
    covariance, and a shrunk one too, is worse as a weight, since the directions
    in which it happens to be small dominate the second step.

    Parameters
    ----------
    deviations
        Coefficients of the members less the estimate, shape (members, terms).
    triangle
        Triangular factor of the regressors, shape (terms, terms).
    variance
        Variance of the residual.
    """
    size = deviations.shape[1]
    # In these coordinates least squares has the covariance `variance` times unity.
    factor = max(variance, float(np.mean((deviations @ triangle.T) ** 2)))
    scale = np.linalg.norm(triangle, axis=0)
    inverse = np.linalg.solve(triangle / scale, np.eye(size)) / scale[:, None]
    return np.asarray(factor * inverse @ inverse.T)


def unusable(sparse: BlackBox, model: PilotModel) -> str:
    """Why a sparse model is no model of a pilot; empty if it is one."""
    for channel, numerator in zip(model.channels, sparse.numerators, strict=True):
        if not numerator.any():
            return f"no term of the {channel.name} channel survives the threshold"
    poles = np.abs(sparse.poles)
    if poles.size and poles.max() >= 1.0:
        return f"the sparse model has an unstable pole of magnitude {poles.max():.3g}"
    return ""


def undetermined(response: FrequencyResponse, model: PilotModel) -> str:
    """Why a response is too vague to fit a pilot model to; empty if it is not."""
    errors = np.median(response.std / np.abs(response.value), axis=1)
    worst = int(np.argmax(errors))
    if errors[worst] <= VAGUE:
        return ""
    name = model.channels[worst].name
    return f"the response of the {name} channel has errors of {errors[worst]:.2g} times its size"
