"""Sums of squares of very many parameter sets that lie near one another.

Draws of a posterior crowd around one pilot, and their prediction errors are all but combinations
of those of a hundred draws: to ten digits they span some fifty dimensions, of thousands that a
recording has.  A draw's place among these shows at a hundred frequencies; its sum of squares
follows from the inner products of the few draws that were evaluated in full.  What a draw has
beyond that span shows at those frequencies too, and where it is not mere rounding the draw is
evaluated in full as well.  Some that are evaluated in full prove that all this is so here.
(Reduced bases by snapshots: Hesthaven, Rozza and Stamm, Certified Reduced Basis Methods, 2016.)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from pilotid.time_domain.output_error import Residuals
from pilotid.time_domain.prediction import Prediction
from pilotid.time_domain.prediction_errors import PredictionErrors
from pilotid.types import ComplexArray, FloatArray, IntArray

BLOCK = 16  # parameter sets evaluated at once in full: about what the processor's cache holds
MANY = 128  # parameter sets evaluated at once at few frequencies
FREQUENCIES = 160  # at which a parameter set is placed, at the most
SNAPSHOTS = 160  # parameter sets that are learnt from at a time
ROUNDS = 3  # of learning, at the most, in one call
MOST = 2**24  # numbers that are kept of all snapshots, at the most
SPAN = 1e-14  # size of the smallest dimension kept, in that of the largest
BEYOND = 1e-11  # share of a parameter set's errors that may lie beyond the span
PROVED = 16  # of so many snapshots one is not learnt from, but tells whether sums are right
RIGHT = 3e-9  # share by which a sum of squares may be wrong


class Nearby:
    """Sums of squares of prediction errors, from a growing number of snapshots.

    Parameters
    ----------
    joint
        Prediction, model of the remnant and analysis band; see `suits`.
    residuals
        The residuals of its prediction.
    """

    def __init__(self, joint: PredictionErrors, residuals: Residuals) -> None:
        self._joint, self._residuals = joint, residuals
        self._some = _at(joint.prediction, _telling(joint.prediction))
        self._places = Residuals(self._some)
        terms = joint.prediction.band_terms
        width = joint.prediction.scored if terms is None else 2 * terms.weights.size
        self._errors = np.zeros((0, joint.prediction.runs * width))
        self._placed = np.zeros((0, 2 * self._some.control_spectrum.size))
        self._products = np.zeros((0, 0))
        self._basis = self._placed
        self._squares = self._products
        self._trusted = True

    @staticmethod
    def suits(prediction: Prediction) -> bool:
        """Whether this is any faster: not for inputs that vary in time, nor for short records."""
        size = prediction.runs * prediction.scored
        return not prediction.model.changes and SNAPSHOTS * size <= MOST

    def sums_of_squares(self, values: FloatArray, taps: FloatArray) -> FloatArray:
        """Sums of squares of the prediction errors, shape (sets,).

        Parameters
        ----------
        values
            Sets of pilot parameters and whatever follows them, shape (sets, parameters).
        taps
            The whitening filter of each, shape (sets, taps).
        """
        sums = np.full(len(values), np.nan)
        left = np.arange(len(values))
        if self._trusted and len(self._basis):
            left = self._place(values, taps, left, sums)
        for _ in range(ROUNDS):
            full = (len(self._errors) + SNAPSHOTS) * self._errors.shape[1] > MOST
            if not self._trusted or full or left.size < 2 * SNAPSHOTS:
                break
            chosen = np.zeros(left.size, dtype=bool)
            chosen[np.linspace(0, left.size - 1, SNAPSHOTS).astype(int)] = True
            sums[left[chosen]] = self._learn(values[left[chosen]], taps[left[chosen]])
            left = left[~chosen]
            if self._trusted:
                left = self._place(values, taps, left, sums)
        sums[left] = sums_of_squares(self._joint, self._residuals, values[left], taps[left])
        return sums

    def _learn(self, values: FloatArray, taps: FloatArray) -> FloatArray:
        """Sums of squares in full, of parameter sets that others will be combined from."""
        errors = np.empty((len(values), self._errors.shape[1]))
        for own in blocks(len(values), BLOCK):
            errors[own] = prediction_errors(self._joint, self._residuals, values[own], taps[own])
        sums = np.asarray(np.einsum("st,st->s", errors, errors))
        placed = self._spectra(values, taps)
        proving = np.arange(len(values)) % PROVED == PROVED // 2
        learnt = np.isfinite(sums) & np.isfinite(placed).all(axis=1) & placed.any(axis=1) & ~proving
        if not learnt.any():
            self._trusted = False
            return sums
        self._add(errors[learnt], placed[learnt])
        proof = np.full(len(values), np.nan)
        self._place(values, taps, np.flatnonzero(proving), proof)
        self._trusted = not np.any(np.abs(proof - sums) > RIGHT * sums)  # false for NaN
        return sums

    def _add(self, errors: FloatArray, placed: FloatArray) -> None:
        """Learn from snapshots, shapes (sets, samples) and (sets, n)."""
        # All of one size, so that rounding errors of large ones do not drown small ones.
        scale = np.linalg.norm(placed, axis=1)[:, None]
        errors /= scale
        placed /= scale
        products = errors @ errors.T
        if len(self._errors):
            across = self._errors @ errors.T
            products = np.block([[self._products, across], [across.T, products]])
            errors = np.concatenate([self._errors, errors])
            placed = np.concatenate([self._placed, placed])
        self._errors, self._placed, self._products = errors, placed, products
        left, size, basis = np.linalg.svd(self._placed, full_matrices=False)
        kept = size > SPAN * size[0]
        weights = left[:, kept] / size[kept]
        self._basis = basis[kept]
        self._squares = weights.T @ self._products @ weights

    def _place(
        self, values: FloatArray, taps: FloatArray, left: IntArray, sums: FloatArray
    ) -> IntArray:
        """Fill in the sums of those that lie within the span; returns those that do not."""
        beyond = []
        for block in blocks(left.size, MANY):
            own = left[block]
            placed = self._spectra(values[own], taps[own])
            along = placed @ self._basis.T
            rest = np.linalg.norm(placed - along @ self._basis, axis=1)
            within = rest <= BEYOND * np.linalg.norm(placed, axis=1)  # false for NaN
            along = along[within]
            sums[own[within]] = np.einsum("sk,sk->s", along @ self._squares, along)
            beyond.append(own[~within])
        return np.concatenate(beyond) if beyond else left

    def _spectra(self, values: FloatArray, taps: FloatArray) -> FloatArray:
        """Transforms of the prediction errors at few frequencies, as real numbers, (sets, n)."""
        spectra = _whitened(self._places, values[:, : self._joint.pilot], taps)
        return np.ascontiguousarray(spectra).view(float).reshape(len(values), -1)


def sums_of_squares(
    joint: PredictionErrors, residuals: Residuals, values: FloatArray, taps: FloatArray
) -> FloatArray:
    """Sums of squares of the prediction errors in full, shape (sets,); see `Nearby`."""
    sums = np.empty(len(values))
    for block in blocks(len(values), BLOCK):
        errors = prediction_errors(joint, residuals, values[block], taps[block])
        sums[block] = np.vecdot(errors, errors)
    return sums


def prediction_errors(
    joint: PredictionErrors, residuals: Residuals, values: FloatArray, taps: FloatArray
) -> FloatArray:
    """Prediction errors of parameter sets, weighted in a band, shape (sets, n)."""
    spectra = _whitened(residuals, values[:, : joint.pilot], taps)
    prediction = joint.prediction
    errors = prediction.without_nuisance(prediction.samples_of(spectra))
    if prediction.band_terms is not None:
        errors = prediction.weighed(errors)
    return errors.reshape(len(values), -1)


def _whitened(residuals: Residuals, pilots: FloatArray, taps: FloatArray) -> ComplexArray:
    """Transforms of the prediction errors, shape (sets, runs, bins)."""
    spectra = residuals.spectra(pilots)
    if taps.shape[1] > 1:
        spectra *= residuals.prediction.filter_response(taps)[:, None, :]
    return spectra


def _telling(prediction: Prediction) -> IntArray:
    """Bins that tell parameter sets apart: the strongest of each of many groups."""
    bins = prediction.s.size
    edges = np.unique(np.geomspace(1.0, bins, FREQUENCIES + 1).round().astype(int))
    power = np.sum(np.abs(prediction.control_spectrum) ** 2, axis=0)
    groups = pairwise(edges.tolist())
    return np.array([0, *(low + int(np.argmax(power[low:high])) for low, high in groups)])


def _at(prediction: Prediction, bins: IntArray) -> Prediction:
    """The prediction at some of its bins alone."""
    return replace(
        prediction,
        s=prediction.s[bins],
        spectra=tuple(spectrum[:, bins] for spectrum in prediction.spectra),
        control_spectrum=prediction.control_spectrum[:, bins],
    )


def blocks(count: int, size: int) -> Iterator[slice]:
    """Slices that cover so many, in blocks of a size."""
    for begin in range(0, count, size):
        yield slice(begin, min(begin + size, count))
