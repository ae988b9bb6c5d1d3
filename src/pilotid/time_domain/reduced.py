"""A prediction reduced to a hundred or so frequencies, for searches.

A sum of squares over the bins of a transform needs, at each frequency, no more than the
products of the inputs and the control with one another; and neighbouring bins, between which
no pilot's response changes noticeably, need only the sum of their products.  A factor of that
sum is a handful of signals that stand for all bins and all runs: the search then costs the
same for one run of 30 s and for ten runs of an hour.

What is lost are the edges: all signals fade in and out over the scored part of the recording,
as if the pilot's memory were short beside it.  That is near enough to find an optimum, not to
report it.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, fields

import numpy as np

from pilotid.time_domain.prediction import Prediction
from pilotid.types import BoolArray, ComplexArray, FloatArray

#: A group of bins is this share of its frequency wide, and at most so many rad/s.
SHARE, WIDEST = 1.0 / 15.0, 0.35

MANY = 12  # parameter sets evaluated at once: a hundred frequencies of each fit the cache


@dataclass(frozen=True)
class Reduced(Prediction):
    """A prediction whose samples are weighted spectra at few frequencies.

    Attributes
    ----------
    counted
        Scored samples of all runs of the prediction that it stands for.
    weights
        Of the spectra at each frequency, shape (groups,).
    """

    counted: int
    weights: FloatArray

    @property
    def samples(self) -> int:
        return self.counted

    @property
    def block(self) -> int:
        return MANY

    def samples_of(self, spectrum: ComplexArray) -> FloatArray:
        weighted = np.ascontiguousarray(spectrum * self.weights)
        return weighted.view(float)

    def delayed_samples(self, spectrum: ComplexArray, most: int) -> FloatArray:
        delays = self._far_shifts[1 : most + 1]
        return self.samples_of(spectrum[:, None] * delays[:, None])

    def weighed(self, rows: FloatArray) -> FloatArray:
        """The rows: `weights` are those of the band already."""
        return rows

    def below(self, band: float) -> Reduced:
        """The same with what lies above a frequency [rad/s] left out."""
        return self._with(self.s.imag < band)

    def _with(self, chosen: BoolArray) -> Reduced:
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        given |= {
            "s": self.s[chosen],
            "spectra": tuple(spectrum[:, chosen] for spectrum in self.spectra),
            "control_spectrum": self.control_spectrum[:, chosen],
            "weights": self.weights[chosen],
        }
        return Reduced(**given)


def reduced(prediction: Prediction) -> Prediction:
    """The prediction at few frequencies; the mean and what the window makes of it are left out.

    One whose inputs vary in time has no such form, and stays as it is.
    """
    if prediction.model.changes:
        return prediction
    scored = prediction.scored
    window = np.sqrt(8.0 / 3.0) * np.sin(np.pi * (np.arange(scored) + 0.5) / scored) ** 2
    given = np.array([*prediction.spectra, prediction.control_spectrum])
    signals = np.fft.rfft(prediction.samples_of(given) * window)
    omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(scored, prediction.dt), dtype=float)
    groups = _groups(omega)
    sizes = np.sqrt(np.mean(np.abs(signals) ** 2, axis=(1, 2)))
    sizes[sizes == 0.0] = 1.0
    signals = signals / sizes[:, None, None]
    products = np.einsum("irk,jrk->kij", signals, signals.conj())
    summed = np.add.reduceat(products, groups[:-1], axis=0)[: len(groups) - 1]
    size, vectors = np.linalg.eigh(summed)
    factor = vectors * np.sqrt(np.maximum(size, 0.0))[:, None, :]
    spectra = np.transpose(factor, (1, 2, 0)) * sizes[:, None, None]  # (signal, part, group)
    counts = np.diff(groups)
    middle = np.add.reduceat(omega, groups[:-1])[: len(groups) - 1] / counts
    held = {field.name: getattr(prediction, field.name) for field in fields(Prediction)}
    held |= {
        "s": 1j * middle,
        "spectra": tuple(spectra[:-1]),
        "control_spectrum": spectra[-1],
        "terms": (),
    }
    # Parseval: bins stand for two, but for the one at half the sampling rate.
    weights = np.full(len(counts), np.sqrt(2.0 / scored))
    if prediction.weighting is None or prediction.band_terms is None:
        return Reduced(**held, counted=prediction.runs * scored, weights=weights)
    weights = weights * np.sqrt(prediction.weighting.weights(middle))
    counted = prediction.band_terms.residuals
    return Reduced(**held, counted=counted, weights=weights)._with(weights > 0.0)


def _groups(omega: FloatArray) -> list[int]:
    """First bins of the groups, and the end of the last."""
    listed = omega.tolist()
    starts = [2]
    while starts[-1] < len(listed):
        first = listed[starts[-1]]
        end = bisect_right(listed, first + min(SHARE * first, WIDEST))
        starts.append(max(end, starts[-1] + 1))
    return starts
