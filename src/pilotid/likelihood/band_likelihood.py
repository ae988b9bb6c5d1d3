"""The likelihood of a band: which frequencies count, and the loop that closes over them.

Over some of the bins of a transform the likelihood of the control, given the forcing functions, is

    F = sum W { |N|^2 / S + log S - log |1 + L|^2 },   N = u less its prediction,

with S the remnant's spectrum, L the loop from control to prediction, and W the weight of a bin.
Prediction errors, which leave the last term out, are the likelihood over all frequencies only:
there, and there alone, the integral of log |1 + L|^2 is nil (Bode), since a loop with a delay
answers nothing at once.  Over a band, leaving it out biases the delays of motion channels, by a
standard error and more in bands of 20 to 30 rad/s.

A bin counts as far as the model's inputs are no noise of the recorder.  What does not count is
not lost to the remnant's model, which an autoregression in a part of the frequencies leaves
undetermined: there it describes the control itself, with a small weight.  Nothing of that depends
on the pilot.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pilotid.checks.detectors import band_end
from pilotid.checks.element_fit import closing_element
from pilotid.likelihood.prepare import FAR
from pilotid.likelihood.remnant_models import APART, are_invertible
from pilotid.model.element import ControlledElement
from pilotid.model.loops import turn
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import floors_of, periodogram, running_median
from pilotid.support.types import BoolArray, ComplexArray, FloatArray

#: Share of the Nyquist frequency up to which bins count: above, the filter that all signals pass
#: falls off.
TOP_SHARE = 0.8
#: Weight of uncounted bins in the remnant's model; coverage is the same from .02 to 1 (populations
#: usual and exotic).
OUTSIDE_WEIGHT = 0.1
#: Weights below this are none.
MIN_WEIGHT = 1e-3


@dataclass(frozen=True, eq=False)
class Weighting:
    """What a recording says of its frequencies, in an analysis band.

    Attributes
    ----------
    omega, share
        Frequencies [rad/s], and the weight of a bin there, shape (n,).
    control
        Mean power of the control's bins there, shape (n,): that of a sample, if it were white.
    element
        The controlled element, which closes the loop.
    hidden
        Whether the inputs hardly stand above the recorder's floor anywhere.
    """

    omega: FloatArray
    share: FloatArray
    control: FloatArray
    element: ControlledElement
    hidden: bool

    def weights(self, omega: FloatArray) -> FloatArray:
        """Weights of bins at other frequencies, shape (n,)."""
        return np.asarray(np.interp(omega, self.omega, self.share, right=0.0))

    @property
    def gain_is_flat_above_band(self) -> bool:
        """Whether the loop does not fall off above the band, and tells of the pilot there."""
        edge = TOP_SHARE * float(self.omega[-1])
        gain = np.abs(self.element.response(np.array([edge, 2.0 * edge])))
        return bool(gain[1] >= 0.7 * gain[0])  # 1 of a gain, .5 of an integrator


class BandTerms:
    """What the likelihood of a window has beside the squares of its prediction errors.

    Parameters
    ----------
    weighting
        How frequencies count.
    dt
        Sampling interval [s].
    scored, runs
        Samples of the window, and number of runs.
    poles
        Poles of the nuisance terms that are projected out [rad/s]; 0 is an offset.
    """

    def __init__(
        self, weighting: Weighting, dt: float, scored: int, runs: int, poles: tuple[float, ...]
    ) -> None:
        self.samples = scored
        omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(scored, dt)[1:], dtype=float)
        weights = weighting.weights(omega)
        weights[weights < MIN_WEIGHT] = 0.0
        outside = OUTSIDE_WEIGHT * (1.0 - weights)
        control = np.interp(omega, weighting.omega, weighting.control)
        begins = group_begins(omega, 1.0 / 30.0, 0.25)
        middle = np.add.reduceat(omega, begins) / np.diff([*begins, omega.size])
        left = 2.0 * runs * np.add.reduceat(outside * control, begins)
        lags = np.arange(FAR + 1)
        by_lag = np.cos(np.outer(lags, middle * dt)) @ left
        # The mean is half a bin, unless it is projected out.
        mean = 0.0 if 0.0 in poles else 0.5
        inside = runs * np.add.reduceat(weights, begins)
        whitened = inside + runs * np.add.reduceat(outside, begins)
        #: Weights of the bins of the scored samples from rest on, as far as they count.
        self.weights = np.append(mean, weights[: int(np.flatnonzero(weights)[-1]) + 1])
        #: Factors of a filter by the weights, of all bins.
        self.factors = np.append(2.0 * mean, weights)
        #: Frequencies of groups of bins [rad/s], shape (groups,).
        self.omega = np.append(0.25 * omega[0], middle)
        #: Sums of the weights of all runs in each group, and of those of the remnant's model.
        self.inside = np.append(mean * runs, inside)
        self.whitened = np.append(mean * runs, whitened)
        #: Both for squares of numbers by those of their real and imaginary parts side by side.
        self.signed = np.kron([self.inside, self.whitened], [1.0, -1.0])
        #: Products at all pairs of lags of what does not count, shape (FAR + 1, FAR + 1).
        self.outside: FloatArray = by_lag[APART]
        #: Number of groups that count for the pilot.
        self.counting = int(np.flatnonzero(self.inside)[-1]) + 1
        #: Responses of delays by 0 to FAR samples, shape (FAR + 1, groups).
        self.shifts: ComplexArray = np.exp(-1j * np.outer(lags, self.omega * dt))
        #: Number of real residuals: nuisance terms take some.
        taken = runs * len(set(poles) - {0.0})
        self.residuals = max(1, round(2.0 * float(self.whitened.sum())) - taken)
        #: Unstable poles of the controlled element.  Those slower than the window tells are
        #: integrators, whatever the sign of their real part.
        of_element = np.roots(weighting.element.denominator)
        self.unstable = int(np.sum((of_element.real > 0.0) & (np.abs(of_element) > omega[0])))

    def weighted(self, rows: FloatArray) -> FloatArray:
        """Rows (..., samples) as real numbers whose products are those in the band."""
        spectra = np.fft.rfft(rows)[..., : self.weights.size]
        spectra *= np.sqrt(2.0 * self.weights / rows.shape[-1])
        return np.ascontiguousarray(spectra).view(float)

    def lagged_products(self, signal: FloatArray, order: int) -> FloatArray:
        """Products of a signal delayed by 0, 1, ..., `order` samples, in the band, of all runs.

        Parameters
        ----------
        signal
            The signal from `order` samples before the window on, shape
            (sets, runs, order + samples).
        order
            The longest delay, at most `FAR`.

        Returns
        -------
        FloatArray
            Shape (sets, order + 1, order + 1).
        """
        lags, turned = np.arange(order + 1), self._turned[:, FAR - order : FAR + order + 1]
        apart = order + np.subtract.outer(lags, lags)
        spectra = np.fft.rfft(signal[..., order:])[..., : self.weights.size]
        power = np.sum(spectra.real**2 + spectra.imag**2, axis=1)
        # A window that slides by a sample gains one and loses one.  So the transform at lag l is
        # z^l times the first, and besides the sum over q < l of change l - 1 - q times z^q.
        change = signal[..., order - 1 :: -1][..., :order] - signal[..., : -order - 1 : -1]
        change = np.append(change, np.zeros_like(change[..., :1]), axis=-1)
        before = np.subtract.outer(lags - 1, lags[:-1])
        changes = change[..., np.where(before < 0, order, before)]  # (sets, runs, lag, q)
        across = (spectra @ turned).real[..., apart[:, :-1]]
        across += 0.5 * changes @ turned.real.sum(axis=0)[apart[:-1, :-1]]
        half = np.sum(across @ changes.swapaxes(2, 3), axis=1)
        return np.asarray((power @ turned.real)[:, apart] + half + half.swapaxes(1, 2))

    @cached_property
    def _turned(self) -> ComplexArray:
        """Weights times responses of delays by -FAR to FAR samples, shape (bins, 2 FAR + 1)."""
        bins, lags = np.arange(self.weights.size), np.arange(-FAR, FAR + 1)
        delays = np.exp(-2j * np.pi / self.samples * np.outer(bins, lags))
        return np.asarray(2.0 / self.samples * self.weights[:, None] * delays)

    def filtered(self, rows: FloatArray) -> FloatArray:
        """Rows (..., samples) filtered by the weights: their products with rows are weighted."""
        return np.asarray(np.fft.irfft(np.fft.rfft(rows) * self.factors, n=rows.shape[-1]))

    def are_stable(self, closed: ComplexArray) -> BoolArray:
        """Whether loops are stable, of 1 + L in the groups that count, shape (sets, counting).

        Nyquist's criterion: from the highest frequency down to the lowest the phase of 1 + L goes
        to 0 (a gain at rest), -90 or -180 deg (integrators), less 180 deg for each unstable pole
        of the element; each unstable pole of the loop adds 180 deg.
        """
        phase = np.angle(closed[:, -1]) - turn(closed)
        return np.asarray(phase + np.pi * self.unstable < np.pi / 3.0)

    def of_loop(self, closed: ComplexArray) -> FloatArray:
        """-sum W log |1 + L|^2 of 1 + L in the groups that count, shape (sets, counting)."""
        return np.asarray(-np.log(np.abs(closed) ** 2) @ self.inside[: self.counting])

    def of_whitener(self, taps: FloatArray) -> FloatArray:
        """-sum V log |A|^2 of whitening filters, shape (sets, taps)."""
        whitener = taps @ self.shifts[: taps.shape[-1]]
        return np.asarray(-np.log(np.abs(whitener) ** 2) @ self.whitened)

    def log_determinant(
        self, loop: ComplexArray, taps: FloatArray, slopes: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """-sum W log |1 + L|^2 - sum V log |A|^2, and what it says of the parameters.

        V is the weight of the remnant's model and A its whitening filter.

        Parameters
        ----------
        loop
            Less the derivatives of 1 + L by the pilot's p parameters, and 1 + L itself, in the
            groups that count, shape (sets, p + 1, counting).
        taps, slopes
            Whitening filters, shape (sets, taps), and their derivatives, shape (sets, r, taps).

        Returns
        -------
        The term, shape (sets,), its slopes, shape (sets, p + r), and the information in it at
        unit variance, shape (sets, p + r, p + r).
        """
        counting, pilots = self.counting, loop.shape[1] - 1
        # Slopes are real: so are the products, of real and imaginary parts side by side.
        filters = np.concatenate([slopes, taps[:, None]], axis=1)
        responses = (filters @ self.shifts[: taps.shape[-1]].view(float)).view(complex)
        by_remnant = responses[:, :-1] / responses[:, -1:]
        by_pilot = loop[:, :-1] * (-1.0 / loop[:, -1:])
        term = self.of_loop(loop[:, -1]) + self.of_whitener(taps)
        # Not conjugated: with the products of the rows this makes the squares of real parts.
        rows = np.concatenate([by_pilot, by_remnant[..., :counting]], axis=1).view(float)
        remnant = by_remnant.view(float)
        information = (rows * self.signed[0, : 2 * counting]) @ rows.transpose(0, 2, 1)
        information[:, pilots:, pilots:] = (remnant * self.signed[1]) @ remnant.transpose(0, 2, 1)
        slope = np.concatenate(
            [by_pilot.real @ self.inside[:counting], by_remnant.real @ self.whitened], axis=1
        )
        return term, -2.0 * slope, 2.0 * information


def most_likely_regression(
    products: FloatArray, terms: BandTerms | None
) -> tuple[FloatArray, FloatArray]:
    """Autoregressions that are most likely, each given its pilot.

    Parameters
    ----------
    products
        Products of the residual at all pairs of lags, those outside the band included, shape
        (sets, order + 1, order + 1).
    terms
        The band; None for direct prediction errors.

    Returns
    -------
    Whitening filters, shape (sets, order + 1), and log-determinants there, shape (sets,), of the
    Hessians of (n / 2) log(sum of squares) - sum V log |A|^2; of half the sum of squares without a
    band.  They are NaN where it is no maximum.
    """
    taps, hessian = np.ones(products.shape[:2]), products[:, 1:, 1:]
    taps[:, 1:] = -np.linalg.solve(hessian, products[:, 1:, :1])[..., 0]
    if terms is not None:
        order, size = products.shape[1] - 1, float(terms.residuals)
        shifts = terms.shifts[: 2 * order + 1]
        sums = np.add.outer(np.arange(1, order + 1), np.arange(1, order + 1))
        for _ in range(4):
            along = (products @ taps[..., None])[..., 0]
            squares = np.vecdot(along, taps)
            inverse = 1.0 / (taps @ shifts[: order + 1])
            slope = size * along[:, 1:] / squares[:, None]
            slope -= 2.0 * ((inverse * terms.whitened) @ shifts[1 : order + 1].T).real
            hessian = size * products[:, 1:, 1:] / squares[:, None, None]
            across = along[:, 1:] / squares[:, None]
            hessian -= 2.0 * size * across[:, :, None] * across[:, None, :]
            hessian += 2.0 * ((inverse**2 * terms.whitened) @ shifts.T).real[:, sums]
            taps[:, 1:] -= np.linalg.solve(hessian, slope[..., None])[..., 0]
    sign, log_determinant = np.linalg.slogdet(hessian)
    # In a band the likelihood of a filter that predicts from samples to come has no bound.
    is_bounded = (sign > 0.0) & ((terms is None) | are_invertible(taps))
    return taps, np.where(is_bounded, log_determinant, np.nan)


def group_begins(omega: FloatArray, share: float, widest: float) -> list[int]:
    """First bins of the groups of bins at `omega` [rad/s].

    A group is a share of its frequency wide, and at most so many rad/s.
    """
    listed, begins = omega.tolist(), [0]
    while begins[-1] < len(listed):
        lowest = listed[begins[-1]]
        end = bisect_right(listed, lowest + min(share * lowest, widest))
        begins.append(max(end, begins[-1] + 1))
    return begins[:-1]


def weighting_of(
    recording: Recording,
    model: PilotModel,
    control: FloatArray,
    dt: float,
    others: tuple[str, ...] = (),
) -> Weighting | None:
    """How the frequencies of a recording count.

    Parameters
    ----------
    recording, model
        The recording, and the model that is fitted to it.
    control, dt
        The control in the analysis band, shape (runs, samples), and its sampling interval [s].
    others
        Signals whose floors count besides those of the model's inputs.

    Returns
    -------
    Weighting or None
        None where the likelihood of a band is not to be had: no controlled element is known, or
        the pilot varies in time or acts on an extra signal, so that the loop has no known
        frequency response.
    """
    if model.changes or model.extra or (element := closing_element(recording)) is None:
        return None
    floors, nyquist = floors_of(recording), math.pi / dt
    inside = floors.omega <= nyquist
    omega = floors.omega[inside]
    share = floors.share((*(channel.on for channel in model.channels), *others))[inside]
    power = np.interp(omega, *running_median(*periodogram(control, dt))) * nyquist
    share = np.where(omega <= min(TOP_SHARE * nyquist, band_end(recording)), share, 0.0)
    share[share < MIN_WEIGHT] = 0.0
    # Three bins for each of seven parameters.
    hidden = float(np.mean(share)) * control.shape[1] / 2.0 < 20.0
    if hidden:
        share = np.where(omega <= TOP_SHARE * nyquist, 1.0, 0.0)
    return Weighting(omega, share, power, element, hidden)
