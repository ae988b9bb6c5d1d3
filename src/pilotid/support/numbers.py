"""Numbers: what chance allows, covariances, random generators, and ranges of settings."""

from __future__ import annotations

import dataclasses
from zlib import crc32

import numpy as np

from pilotid.support.types import FloatArray, InputError

#: Standard deviations on either side of the mean that hold 95 % of a normal distribution.
Z95 = 1.959963984540054
#: p-value below which a difference is called significant.
LEVEL = 0.05
#: The 95 % quantile of chi-squared with one degree of freedom.
CHI_SQUARED_95 = 3.841458820694124
#: The same with two degrees of freedom.
CHI_SQUARED_95_OF_TWO = 5.991464547107979


def chi_squared_limit(freedom: float, chance: float) -> float:
    """What a chi-squared variable exceeds with a small probability.

    Parameters
    ----------
    freedom
        Degrees of freedom.
    chance
        The probability, for example 0.001.
    """
    from scipy.special import chdtri

    return float(chdtri(freedom, chance))


def chi_squared_tail(freedom: float, value: float) -> float:
    """How often a chi-squared variable exceeds a value.

    Parameters
    ----------
    freedom
        Degrees of freedom.
    value
        The value.
    """
    from scipy.special import chdtrc

    return float(chdtrc(freedom, max(value, 0.0)))


def rms(signal: FloatArray) -> float:
    """Root mean square of all samples of a signal."""
    return float(np.sqrt(np.mean(signal**2)))


#: Ratio of the smallest to the largest eigenvalue below which rounding decides.
SINGULAR = 1e-13


def covariance_of(hessian: FloatArray, variance: float) -> FloatArray | None:
    """Inverse of a least-squares information matrix, or None if it is singular.

    Parameters
    ----------
    hessian
        Inner products J'J, shape (parameters, parameters).
    variance
        Variance of the white residual.
    """
    inverted = scaled_inverse(hessian)
    if inverted is None:
        return None
    inverse, scale = inverted
    return np.asarray(variance * inverse / np.outer(scale, scale))


def scaled_inverse(
    matrix: FloatArray, least: float = SINGULAR
) -> tuple[FloatArray, FloatArray] | None:
    """Inverse of a matrix scaled to a unit diagonal, and the scale; None if it is singular."""
    diagonal = np.diag(matrix)
    if not (np.all(np.isfinite(matrix)) and np.all(diagonal > 0.0)):
        return None
    scale = np.sqrt(diagonal)
    eigenvalues, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    if eigenvalues[0] <= least * eigenvalues[-1]:
        return None
    return (vectors / eigenvalues) @ vectors.T, scale


DEFAULT_SEED = 1


def recording_rng(seed: int, scenario: str, replication: int = 0) -> np.random.Generator:
    """The generator of a simulated recording's remnant.

    Parameters
    ----------
    seed, scenario, replication
        Seed of all random numbers, name of the scenario, and which of its recordings.
    """
    return _generator(seed, crc32(scenario.encode()), replication)


def fit_rng(
    seed: int, method: str, scenario: str = "", replication: int = 0
) -> np.random.Generator:
    """The generator of a fit; a recording from a file has no scenario and no replication.

    Parameters
    ----------
    seed, scenario, replication
        As for `recording_rng`.
    method
        Label of the method.
    """
    rng = _generator(seed, crc32(scenario.encode()), replication, crc32(method.encode()))
    state = rng.bit_generator.state
    # The seed itself would tell a method the truth that was drawn with it.
    told = np.random.PCG64(rng.integers(2**32, size=4))
    told.state = state  # type: ignore[assignment]
    return np.random.Generator(told)


def start_rng(seed: int, scenario: str, replication: int = 0) -> np.random.Generator:
    """The generator of a replication's initial guesses, the same for every method.

    Parameters
    ----------
    seed, scenario, replication
        Seed of all random numbers, name of the scenario, and which of its recordings.
    """
    return _generator(seed, crc32(scenario.encode()), replication, crc32(b"start"))


def draw_rng(seed: int, scenario: str, replication: int = 0) -> np.random.Generator:
    """The generator of what a population draws for a replication, the same for every method.

    Parameters
    ----------
    seed, scenario, replication
        Seed of all random numbers, name of the scenario, and which of its recordings.
    """
    return _generator(seed, crc32(scenario.encode()), replication, crc32(b"draw"))


def _generator(seed: int, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


#: Least and largest settings of the methods of this package: whole numbers, and others.
COUNT, SIZE, ANY = (1, 1000), (1e-12, 1e6), (-np.inf, np.inf)
#: Those of other ranges.
SETTINGS: dict[str, tuple[float, float]] = {
    **dict.fromkeys(("misfit", "removed", "threshold"), (0.0, 1.0)),
    "delays": (0.0, 5.0),
    "trend": (0, 10),
    "pade_order": (1, 10),
    "most": (1, 10**6),
    # Of scenarios.
    "dt": (1e-5, 1.0),
    "duration": (1.0, 1e6),
    "run_in": (0.0, 3600.0),
    "runs": (1, 1000),
    "start_spread": (0.0, 10.0),
}


def require_settings(thing: object) -> None:
    """Refuse settings of a method or scenario of this package that are out of their ranges."""
    usual = {"methods": (COUNT, SIZE), "datasets": (ANY, ANY)}
    package = type(thing).__module__.removeprefix("pilotid.").partition(".")[0]
    if not dataclasses.is_dataclass(thing) or package not in usual:
        return
    for field in dataclasses.fields(thing):
        low, high = SETTINGS.get(field.name, usual[package]["int" not in str(field.type)])
        given = getattr(thing, field.name)
        for value in given if isinstance(given, tuple | list) else (given,):
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if is_number and not low <= value <= high:
                raise InputError(f"{field.name} {value}: must be from {low:g} to {high:g}")
