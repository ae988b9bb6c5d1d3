"""The choice of the remnant's model."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pilotid.time_domain.band import Band
from pilotid.time_domain.remnant_models import Autoregressive, BandPass, LowPass, NoiseModel
from pilotid.time_domain.whitening import FAR, shifted_products
from pilotid.types import FloatArray

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
    products = shifted_products(np.sum(by_lag, axis=0), gained.T @ gained - lost.T @ lost)
    return np.asarray(products / (runs * (samples - FAR)))


#: Contenders lie this close: the residual of a first estimate decides no more than that.
CLOSE = 20.0


#: By how much a band-pass must predict better: its corner and the pilot's gain at low frequencies
#: explain one another, and where none is needed it would take the gain for its own.
CORNER = 7.0


def handicap(model: NoiseModel) -> float:
    """By how much the criterion of a model, fitted with the pilot, must be lower to be chosen."""
    return CORNER if isinstance(model, BandPass) else 0.0


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
    """A model of the remnant, and its parameters, shape (parameters,)."""

    model: NoiseModel
    values: FloatArray

    def whitener(self, band: Band) -> FloatArray:
        """The filter that whitens it, shape (taps,)."""
        return np.asarray(self.model.filters(self.values[None], band)[0])


def guessed(model: NoiseModel, residual: FloatArray, band: Band) -> FloatArray:
    """The parameters of a noise model that a residual (runs, samples) suggests."""
    return model.guess(lagged_products(residual), band)[0]


def suiting(residual: FloatArray, band: Band) -> Guess:
    """The noise model that suits a residual (runs, samples) best."""
    return contenders(lagged_products(residual), residual.size, band)[0]


def contenders(products: FloatArray, samples: int, band: Band) -> list[Guess]:
    """The noise model that suits a residual best, and the best of the other kind if it is close.

    The kinds are filters of white noise and autoregressions.  Beside a band-pass stands the best
    low-pass as well: whether there is a corner is for `CORNER` to decide.

    Parameters
    ----------
    products
        The residual's `lagged_products`, before whitening.
    samples
        Its samples in all runs.
    band
        The analysis band.
    """
    scored: dict[bool, list[tuple[float, Guess]]] = {False: [], True: []}
    for model in NOISE_MODELS:
        values, power = model.guess(products, band)
        scored[model.regressive].append((criterion(model, power, samples), Guess(model, values)))
    best = [min(kind, key=_score) for kind in scored.values()]
    if isinstance(best[0][1].model, BandPass):
        plain = [each for each in scored[False] if not isinstance(each[1].model, BandPass)]
        best.append(min(plain, key=_score))
    best.sort(key=_score)
    return [guess for score, guess in best if score < best[0][0] + CLOSE]


def _score(scored: tuple[float, Guess]) -> float:
    return scored[0]


def neighbours(model: NoiseModel) -> list[NoiseModel]:
    """The next shorter and the next longer autoregression; none for another kind of model."""
    if not model.regressive or model not in NOISE_MODELS:
        return []
    place = NOISE_MODELS.index(model)
    beside = [NOISE_MODELS[place - 1], *NOISE_MODELS[place + 1 : place + 2]]
    return [other for other in beside if other.regressive]
