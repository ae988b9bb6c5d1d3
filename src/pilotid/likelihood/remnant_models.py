"""Models of the remnant's spectrum, and the whitening filters that follow from them.

A noise model of few parameters costs little information: in a closed loop the
pilot's parameters and the remnant's are estimated from the same feedback, and every
free coefficient of the remnant takes some of it (eight autoregressive coefficients
raise the bound of the neuromuscular damping by 4 to 14 % in a band of 31 rad/s, a
low-pass filter's two parameters by 2 % at the most; see `pilotid.datasets.bounds.bounds`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from typing import ClassVar, NamedTuple

import numpy as np

from pilotid.estimate.quantities import RemnantEstimate
from pilotid.likelihood.prepare import FAR, REACH, Band, prediction_error_filters
from pilotid.support.types import BoolArray, FloatArray

#: Lags between samples of a filter, shape (FAR + 1, FAR + 1).
APART = np.abs(np.subtract.outer(np.arange(FAR + 1), np.arange(FAR + 1)))
#: Bounds of the parameters of filters; autoregressive coefficients have none.
BOUNDS = {"frequency": (0.2, 200.0), "damping": (0.05, 5.0), "corner": (0.05, 10.0)}


@dataclass(frozen=True)
class LowPass:
    """White noise through a low-pass filter of order 0 (white) to 3, as `Remnant` has it.

    Attributes
    ----------
    order
        Its order, 0 to 3.
    regressive
        Whether parameters are coefficients of the residual's own past.
    reach
        How far its filters reach back [samples].
    """

    order: int
    regressive: ClassVar[bool] = False
    reach: ClassVar[int] = REACH

    @property
    def name(self) -> str:
        """What it is called."""
        return ("white", "first-order", "second-order", "third-order")[self.order]

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of its parameters."""
        return ("frequency", "damping")[: self.order]

    def power(self, omega: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Spectra at `omega` [rad/s], and the derivatives of their logarithms.

        Parameters
        ----------
        omega
            Frequencies, shape (n,).
        values
            Parameter sets, shape (sets, parameters).

        Returns
        -------
        Shapes (sets, n) and (parameters, sets, n).
        """
        power, by_ratio = np.ones((len(values), omega.size)), np.zeros(1)
        if self.order == 0:
            return power, np.zeros((0, *power.shape))
        ratio = (omega / values[:, :1]) ** 2  # (w / w0)^2
        by_damping: tuple[FloatArray, ...] = ()
        if self.order > 1:
            damping = values[:, 1:2]
            second = (1.0 - ratio) ** 2 + 4.0 * damping**2 * ratio
            power = power / second
            by_ratio = (-2.0 * (1.0 - ratio) + 4.0 * damping**2) / second
            by_damping = (-8.0 * damping * ratio / second,)
        if self.order != 2:
            power, by_ratio = power / (1.0 + ratio), by_ratio + 1.0 / (1.0 + ratio)
        return power, np.array([2.0 * ratio * by_ratio / values[:, :1], *by_damping])

    def taps(self, values: FloatArray, band: Band) -> tuple[FloatArray, FloatArray]:
        """Whitening filters and their derivatives.

        Parameters
        ----------
        values
            Parameter sets, shape (sets, parameters).
        band
            The analysis band.

        Returns
        -------
        Taps, shape (sets, taps), the first of which is one, and their derivatives,
        shape (sets, parameters, taps).
        """
        power, log_slopes = self.power(band.folded[0], values)
        spectra = np.concatenate([power[None], power * log_slopes])
        every = band.autocovariance(spectra, self.reach)
        autocovariance, own_slopes, lags = every[0], every[1:], APART[: self.reach, : self.reach]
        inverse = np.linalg.inv(autocovariance[:, lags])
        taps = np.ones_like(autocovariance)
        taps[:, 1:] = -(inverse @ autocovariance[:, 1:, None])[..., 0]
        slopes = np.zeros((len(taps), len(own_slopes), self.reach + 1))
        right = own_slopes[..., 1:, None] + own_slopes[..., lags] @ taps[:, 1:, None]
        slopes[:, :, 1:] = np.swapaxes(-(inverse @ right)[..., 0], 0, 1)
        return taps, slopes

    def filters(self, values: FloatArray, band: Band) -> FloatArray:
        """Whitening filters alone, fast for many sets, shape (sets, taps)."""
        power, _ = self.power(band.folded[0], values)
        return prediction_error_filters(band.autocovariance(power, self.reach))

    def grid(self) -> tuple[FloatArray, ...]:
        """Values of each parameter, which together cover all spectra of the family."""
        return (np.geomspace(0.5, 60.0, 40), np.geomspace(0.12, 1.8, 12))[: len(self.keys)]

    def guess(self, products: FloatArray, band: Band) -> tuple[FloatArray, float]:
        """Parameters that suit a residual, by its `lagged_products`, and the power they leave."""
        grid, taps = _catalogue(self, band)
        reach = taps.shape[1]
        power = np.sum((taps @ products[:reach, :reach]) * taps, axis=1)
        least = int(np.argmin(power))
        return grid[least], float(power[least])


@dataclass(frozen=True)
class BandPass(LowPass):
    """A low-pass of order 1 or 2 times a first-order high-pass, s / (s + corner).

    What pilots do at low frequencies is regulated away, so that a remnant may have little power
    there.  A filter that whitens it reaches further back than others.

    Attributes
    ----------
    order
        Order of the low-pass, 1 or 2.
    """

    reach: ClassVar[int] = FAR

    @property
    def name(self) -> str:
        return f"{super().name} band-pass"

    @property
    def keys(self) -> tuple[str, ...]:
        return (*super().keys, "corner")

    def power(self, omega: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Spectrum at `omega` [rad/s] and the derivatives of its logarithm, see `LowPass.power`."""
        power, slopes = super().power(omega, values[:, :-1])
        corner = values[:, -1:]
        below = omega**2 + corner**2
        # A hundredth is left at rest: a spectrum without power there has no filter.
        above = omega**2 + 1e-4 * corner**2
        by_corner = 2e-4 * corner / above - 2.0 * corner / below
        return power * above / below, np.concatenate([slopes, by_corner[None]])

    def grid(self) -> tuple[FloatArray, ...]:
        """As `LowPass.grid`, coarser."""
        low = (np.geomspace(0.5, 60.0, 16), np.geomspace(0.15, 1.6, 6))[: self.order]
        return (*low, np.geomspace(0.15, 4.0, 6))


@dataclass(frozen=True)
class Autoregressive:
    """An autoregressive spectrum of free shape, for remnants that no low-pass describes.

    Attributes
    ----------
    order
        Number of coefficients.
    """

    order: int
    regressive: ClassVar[bool] = True

    @property
    def name(self) -> str:
        return f"AR({self.order})"

    @property
    def keys(self) -> tuple[str, ...]:
        return tuple(f"a{i}" for i in range(1, self.order + 1))

    def taps(self, values: FloatArray, band: Band) -> tuple[FloatArray, FloatArray]:
        shape = len(values), self.order, self.order + 1
        taps = np.concatenate([np.ones((len(values), 1)), values], axis=1)
        return taps, np.broadcast_to(np.eye(*shape[1:], k=1), shape)

    def filters(self, values: FloatArray, band: Band) -> FloatArray:
        return self.taps(values, band)[0]

    def guess(self, products: FloatArray, band: Band) -> tuple[FloatArray, float]:
        matrix = products[: self.order + 1, : self.order + 1]
        try:
            values = np.asarray(-np.linalg.solve(matrix[1:, 1:], matrix[1:, 0]))
        except np.linalg.LinAlgError:  # rounding errors are all that is left: white will do
            values = np.zeros(self.order)
        taps = np.concatenate([[1.0], values])
        return values, float(taps @ matrix @ taps)


def are_invertible(taps: FloatArray) -> BoolArray:
    """Whether filters (sets, taps) have no zero well outside the unit circle (Jensen's formula).

    Those that have predict from samples to come, and their likelihood in a band has no meaning.
    """
    circle = 64  # points
    logs = np.log(np.abs(np.fft.rfft(taps, n=circle)) + 1e-300)
    # The mean is 0 where all zeros are inside.
    return np.asarray(2.0 * logs.sum(axis=1) - logs[:, 0] - logs[:, -1] < 0.05 * circle)


@dataclass(frozen=True, eq=False)
class Whitener(Autoregressive):
    """A whitening filter that is known: a model of the remnant without parameters.

    Attributes
    ----------
    known
        The filter, shape (taps,), whose first entry is one.
    """

    order: int = field(default=0, init=False)
    known: FloatArray
    regressive: ClassVar[bool] = False

    def taps(self, values: FloatArray, band: Band) -> tuple[FloatArray, FloatArray]:
        """The filter, shape (1, taps), and no derivatives: it is one for all sets."""
        return self.known[None], np.zeros((1, 0, self.known.size))


#: No filter: the residual of a prediction is white in its band.
WHITE = Whitener(np.ones(1))

#: A model of the remnant's spectrum, up to the power, which is estimated apart.
NoiseModel = LowPass | Autoregressive


def bounds_of(model: NoiseModel) -> FloatArray:
    """Lower and upper bounds of its parameters, shape (2, parameters)."""
    bounds = [BOUNDS.get(key, (-np.inf, np.inf)) for key in model.keys]
    return np.array(bounds).reshape(-1, 2).T


#: The remnant's model before one is chosen: most published remnants are of this kind.
FIRST_NOISE_MODEL = LowPass(2)


@lru_cache(maxsize=32)
def _catalogue(model: LowPass, band: Band) -> tuple[FloatArray, FloatArray]:
    """A grid of parameter sets of a model and their whitening filters."""
    grid = np.array([*product(*model.grid())])
    return grid, model.filters(grid, band)


#: The families to choose from.
NOISE_MODELS: tuple[NoiseModel, ...] = (
    *(LowPass(order) for order in range(4)),
    *(BandPass(order) for order in (1, 2)),
    *(Autoregressive(order) for order in (2, 3, 4, 6, 8, 10, 12, 16, 20)),
)


def lagged_products(residual: FloatArray) -> FloatArray:
    """Mean products of a residual (runs, samples) at all pairs of lags 0 to FAR.

    A filter's output power is then exact, taps @ products @ taps.  Autocovariances would
    not do: their end effects leak from the strong low frequencies of a steep spectrum,
    and a whitening filter magnifies that until a wrong model wins.

    Returns
    -------
    Array of shape (FAR + 1, FAR + 1).
    """
    runs, samples = residual.shape
    by_lag = [np.correlate(run, run[FAR:], mode="valid")[::-1] for run in residual]
    gained, lost = residual[:, FAR - 1 :: -1], residual[:, : samples - FAR - 1 : -1]
    change = gained.T @ gained - lost.T @ lost
    products = np.empty((FAR + 1, FAR + 1))
    products[0] = products[:, 0] = np.sum(by_lag, axis=0)
    for lag in range(FAR):  # those of the next pair of lags differ by the samples at both ends
        products[lag + 1, 1:] = products[lag, :-1] + change[lag]
    return np.asarray(products / (runs * (samples - FAR)))


def criterion(model: NoiseModel, power: float, samples: int, pilot: int = 0) -> float:
    """Akaike's information criterion of a noise model, corrected for few samples.

    It asks which model predicts best, not which one is true: of remnants outside all
    families a long autoregression is never true, and the one that predicts best.

    Parameters
    ----------
    model
        The noise model.
    power
        Mean square of the prediction error.
    samples
        Number of prediction errors.
    pilot
        Number of pilot parameters estimated along with it.
    """
    count = len(model.keys) + pilot + 1  # the variance too
    # A residual that a filter predicts to the last digit leaves rounding, of any sign.
    deviance = samples * math.log(max(power, 1e-300))
    return deviance + 2.0 * count * samples / max(samples - count - 1.0, 1.0)


class Guess(NamedTuple):
    """A model of the remnant with parameters, shape (parameters,), and its criterion."""

    criterion: float
    model: NoiseModel
    values: FloatArray

    def whitener(self, band: Band) -> FloatArray:
        """The filter that whitens it, shape (taps,)."""
        return np.asarray(self.model.filters(self.values[None], band)[0])


def best_noise_model(residual: FloatArray, band: Band) -> Guess:
    """The noise model that suits a residual (runs, samples) best."""
    return min(guesses(residual, band), key=lambda guess: guess.criterion)


def guesses(
    residual: FloatArray, band: Band, models: Sequence[NoiseModel] = NOISE_MODELS
) -> list[Guess]:
    """Noise models as a residual suggests them.

    Parameters
    ----------
    residual
        The residual before whitening, shape (runs, samples).
    band
        The analysis band.
    models
        Which models.
    """
    products, fits = lagged_products(residual), []
    for model in models:
        values, power = model.guess(products, band)
        fits.append(Guess(criterion(model, power, residual.size), model, values))
    return fits


def neighbours(model: NoiseModel) -> list[NoiseModel]:
    """The next shorter and the next longer autoregression; none for another kind of model."""
    place = NOISE_MODELS.index(model)
    beside = NOISE_MODELS[place - 1 : place + 2 : 2]
    return [other for other in beside if other.regressive and model.regressive]


def filter_of(remnant: RemnantEstimate, dt: float) -> tuple[Band, FloatArray, float]:
    """The band that a remnant is known in, its whitening filter, and the variance of the errors.

    Parameters
    ----------
    remnant
        What an estimate says of the remnant.
    dt
        Sampling interval of the recording [s].
    """
    band = Band(dt, max(1, round(float(Band(dt, 1).omega[-1] / remnant.omega[-1]))))
    density = np.interp(band.omega, remnant.omega, remnant.density)
    taps = prediction_error_filters((density @ band.cosines)[None])[0]
    # Of a filter without zeros outside the unit circle the mean of log |.|^2 is 0 (Kolmogorov).
    variance = math.exp(float(np.mean(np.log(density)))) * math.pi / band.dt
    return band, taps, variance
