"""Models of the remnant's spectrum, and the whitening filters that follow from them.

A noise model of few parameters costs little information: in a closed loop the
pilot's parameters and the remnant's are estimated from the same feedback, and every
free coefficient of the remnant takes some of it (eight autoregressive coefficients
raise the bound of the neuromuscular damping by 5 to 14 %, a low-pass filter's two
parameters by less than 3 %; see `pilotid.theory`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np

from pilotid.minimise import minimise
from pilotid.prepare import lowpass
from pilotid.types import BoolArray, FloatArray

REACH = 24  # taps of a whitening filter beyond the first
GRID = 256  # frequencies on which spectra of noise models are integrated


@dataclass(frozen=True)
class Band:
    """The analysis band: sampling interval of a recording, and factor of decimation."""

    recorded_dt: float
    factor: int

    @property
    def dt(self) -> float:
        """Sampling interval after decimation [s]."""
        return self.recorded_dt * self.factor

    @cached_property
    def omega(self) -> FloatArray:
        """Frequencies inside the band [rad/s], shape (grid,)."""
        return np.asarray((np.arange(GRID) + 0.5) * (np.pi / (GRID * self.dt)), dtype=float)

    @cached_property
    def folds(self) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """Frequencies that decimation folds onto `omega`, and the filter's power there."""
        if self.factor == 1:
            return ((self.omega, np.ones(GRID)),)
        folded = (self.omega, 2.0 * np.pi / self.dt - self.omega)
        return tuple((w, self._filter_power(w)) for w in folded)

    def _filter_power(self, omega: FloatArray) -> FloatArray:
        taps = lowpass(self.factor)
        k = np.arange(taps.size) - taps.size // 2
        return np.asarray((np.cos(np.outer(omega * self.recorded_dt, k)) @ taps) ** 2)

    @cached_property
    def cosines(self) -> FloatArray:
        """Maps a spectrum on `omega` to autocovariances, shape (grid, REACH + 1)."""
        return np.asarray(np.cos(np.outer(self.omega * self.dt, np.arange(REACH + 1))) / GRID)


class NoiseModel(Protocol):
    """A family of remnant spectra, up to the power, which is estimated apart.

    It is also a space for `pilotid.minimise.minimise`.
    """

    @property
    def name(self) -> str:
        """As reports print it."""
        ...

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of its parameters."""
        ...

    @property
    def lower(self) -> FloatArray: ...

    @property
    def upper(self) -> FloatArray: ...

    @property
    def positive(self) -> BoolArray: ...

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
        ...

    def guess(self, autocovariance: FloatArray, band: Band) -> FloatArray:
        """Parameters that suit autocovariances at lags 0 to REACH, shape (parameters,)."""
        ...


@dataclass(frozen=True)
class LowPass:
    """White noise through a low-pass filter of order 0 (white) to 3, as `Remnant` has it."""

    order: int

    @property
    def name(self) -> str:
        return ("white", "first-order", "second-order", "third-order")[self.order]

    @property
    def keys(self) -> tuple[str, ...]:
        return ((), ("frequency",), ("frequency", "damping"), ("frequency", "damping"))[self.order]

    @property
    def lower(self) -> FloatArray:
        return np.array((0.2, 0.05))[: len(self.keys)]

    @property
    def upper(self) -> FloatArray:
        return np.array((200.0, 5.0))[: len(self.keys)]

    @property
    def positive(self) -> BoolArray:
        return np.ones(len(self.keys), dtype=bool)

    def power(
        self, omega: FloatArray, values: FloatArray
    ) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        """Spectrum at `omega` [rad/s] and the derivatives of its logarithm.

        Parameters
        ----------
        omega
            Frequencies, shape (n,).
        values
            Parameter sets, shape (sets, parameters).
        """
        sets = values.shape[0]
        if self.order == 0:
            return np.ones((sets, omega.size)), ()
        ratio = (omega / values[:, :1]) ** 2  # (w / w0)^2
        first = 1.0 + ratio
        if self.order == 1:
            return 1.0 / first, (2.0 * ratio / (first * values[:, :1]),)
        damping = values[:, 1:2]
        second = (1.0 - ratio) ** 2 + 4.0 * damping**2 * ratio
        by_ratio = (-2.0 * (1.0 - ratio) + 4.0 * damping**2) / second
        by_damping = -8.0 * damping * ratio / second
        power = 1.0 / second
        if self.order == 3:
            power, by_ratio = power / first, by_ratio + 1.0 / first
        return power, (2.0 * ratio * by_ratio / values[:, :1], by_damping)

    def taps(self, values: FloatArray, band: Band) -> tuple[FloatArray, FloatArray]:
        if self.order == 0 and band.factor == 1:
            return np.ones((len(values), 1)), np.zeros((len(values), 0, 1))
        total = np.zeros((len(values), GRID))
        slopes = np.zeros((len(self.keys), len(values), GRID))
        for omega, weight in band.folds:
            power, log_slopes = self.power(omega, values)
            total += power * weight
            for slope, log_slope in zip(slopes, log_slopes, strict=True):
                slope += power * weight * log_slope
        return _levinson(total @ band.cosines, [slope @ band.cosines for slope in slopes])

    def guess(self, autocovariance: FloatArray, band: Band) -> FloatArray:
        grid, taps = _catalogue(self, band)
        toeplitz = _toeplitz(autocovariance, taps.shape[1])
        values = grid[[int(np.argmin(np.einsum("gi,ij,gj->g", taps, toeplitz, taps)))]]
        if not self.keys:
            return np.asarray(values[0])

        def gram(sets: FloatArray) -> FloatArray:
            taps, slopes = self.taps(sets, band)
            rows = np.concatenate([-slopes, taps[:, None]], axis=1)
            return np.asarray(rows @ toeplitz @ rows.transpose(0, 2, 1))

        return np.asarray(minimise(gram, values, self, tolerance=1e-4, iterations=12).values[0])


@dataclass(frozen=True)
class Autoregressive:
    """An autoregressive spectrum of free shape, for remnants that no low-pass describes."""

    order: int

    @property
    def name(self) -> str:
        return f"AR({self.order})"

    @property
    def keys(self) -> tuple[str, ...]:
        return tuple(f"a{i}" for i in range(1, self.order + 1))

    @property
    def lower(self) -> FloatArray:
        return np.full(self.order, -np.inf)

    @property
    def upper(self) -> FloatArray:
        return np.full(self.order, np.inf)

    @property
    def positive(self) -> BoolArray:
        return np.zeros(self.order, dtype=bool)

    def taps(self, values: FloatArray, band: Band) -> tuple[FloatArray, FloatArray]:
        one = np.ones((len(values), 1))
        slopes = np.broadcast_to(
            np.eye(self.order, self.order + 1, k=1), (len(values), self.order, self.order + 1)
        )
        return np.concatenate([one, values], axis=1), slopes

    def guess(self, autocovariance: FloatArray, band: Band) -> FloatArray:
        taps, _ = _levinson(autocovariance[None, : self.order + 1], [])
        return np.asarray(taps[0, 1:])


def _toeplitz(autocovariance: FloatArray, size: int) -> FloatArray:
    return autocovariance[np.abs(np.subtract.outer(np.arange(size), np.arange(size)))]


def _levinson(
    autocovariance: FloatArray, slopes: list[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Prediction-error filters of autocovariances (sets, lags), and their derivatives."""
    order = autocovariance.shape[1] - 1
    lags = np.abs(np.subtract.outer(np.arange(order), np.arange(order)))
    inverse = np.linalg.inv(autocovariance[:, lags])
    taps = -np.einsum("sij,sj->si", inverse, autocovariance[:, 1:])
    derivatives = [
        -np.einsum("sij,sj->si", inverse, d[:, 1:] + np.einsum("sij,sj->si", d[:, lags], taps))
        for d in slopes
    ]
    one = np.ones((len(taps), 1))
    return (
        np.concatenate([one, taps], axis=1),
        np.stack([np.concatenate([0.0 * one, d], axis=1) for d in derivatives], axis=1)
        if derivatives
        else np.zeros((len(taps), 0, order + 1)),
    )


@lru_cache(maxsize=32)
def _catalogue(model: LowPass, band: Band) -> tuple[FloatArray, FloatArray]:
    """A grid of parameter sets of a low-pass model and their whitening filters."""
    frequencies = np.geomspace(0.5, 60.0, 24)
    dampings = np.array([0.15, 0.3, 0.5, 0.7, 1.0, 1.6])
    axes = (frequencies, dampings)[: len(model.keys)]
    mesh = np.meshgrid(*axes, indexing="ij")
    grid = np.stack([m.ravel() for m in mesh], axis=1) if axes else np.zeros((1, 0))
    return grid, model.taps(grid, band)[0]


#: The families that `select` chooses from.
NOISE_MODELS: tuple[NoiseModel, ...] = (
    *(LowPass(order) for order in range(4)),
    *(Autoregressive(order) for order in range(2, 13)),
)


def autocovariance(residual: FloatArray) -> FloatArray:
    """Autocovariances of a residual (runs, samples) at lags 0 to REACH, runs averaged."""
    samples = residual.shape[1]
    return np.array(
        [
            np.mean(residual[:, lag:] * residual[:, : samples - lag]) * (samples - lag) / samples
            for lag in range(REACH + 1)
        ]
    )


#: Difference of the criterion that Kass and Raftery (1995) call very strong evidence.
STRONG = 10.0


def criterion(power: float, samples: int, parameters: int) -> float:
    """Bayesian information criterion of a noise model: the lower, the better."""
    return samples * math.log(power) + parameters * math.log(samples)


def select(
    residual: FloatArray, band: Band, models: tuple[NoiseModel, ...] = NOISE_MODELS
) -> tuple[NoiseModel, FloatArray]:
    """The noise model with the lowest criterion for a residual, and its parameters.

    An autoregressive model must be better by `STRONG`: a free shape that is not needed
    costs information and biases the low-frequency parameters.
    """
    covariance = autocovariance(residual)
    best: tuple[float, NoiseModel, FloatArray] | None = None
    for model in models:
        values = model.guess(covariance, band)
        taps = model.taps(values[None], band)[0][0]
        power = float(taps @ _toeplitz(covariance, taps.size) @ taps)
        score = criterion(power, residual.size, len(values))
        if isinstance(model, Autoregressive):
            score += STRONG
        if best is None or score < best[0]:
            best = score, model, values
    assert best is not None
    return best[1], best[2]


@dataclass(frozen=True, eq=False)
class RemnantEstimate:
    """The remnant as a method saw it, inside its analysis band.

    Attributes
    ----------
    model
        Name of the noise model.
    parameters
        Its parameters by name (frequencies in rad/s).
    power_ratio
        var(n)/var(u).
    omega
        Frequencies [rad/s], shape (n,).
    density
        One-sided power spectral density [unit of u, squared, per rad/s], shape (n,).
    """

    model: str
    parameters: dict[str, float]
    power_ratio: float
    omega: FloatArray
    density: FloatArray


def remnant_estimate(
    noise: NoiseModel, values: FloatArray, band: Band, innovation: float, control_power: float
) -> RemnantEstimate:
    """What a fitted noise model says of the remnant.

    Parameters
    ----------
    noise, values
        The model and its parameters, shape (parameters,).
    band
        The analysis band.
    innovation
        Variance of the prediction error.
    control_power
        Variance of the control in the band.
    """
    taps = noise.taps(values[None], band)[0][0]
    response = np.exp(-1j * np.outer(band.omega * band.dt, np.arange(taps.size))) @ taps
    density = innovation * band.dt / np.pi / np.abs(response) ** 2
    power = float(np.mean(density) * np.pi / band.dt)
    return RemnantEstimate(
        noise.name,
        dict(zip(noise.keys, values.tolist(), strict=True)),
        power / control_power,
        band.omega,
        density,
    )
