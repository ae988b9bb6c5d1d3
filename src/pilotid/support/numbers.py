"""Numbers: how they are printed, what chance allows, and random generators."""

from __future__ import annotations

import math
from zlib import crc32

import numpy as np

NONE = "-"


def decimals(value: float, digits: int = 2, most: int = 9) -> int:
    """Decimals with which a number that is not zero shows so many digits, at the most `most`."""
    return min(max(digits - 1 - math.floor(math.log10(abs(value))), 0), most)


def number(value: float, digits: int = 3) -> str:
    """A number with that many digits, without an exponent unless it is far off."""
    if not math.isfinite(value):
        return NONE
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        places = decimals(value, digits, digits) if value else 0
        text = f"{value:.{places}f}"
    else:
        text = f"{value:.1e}"
    return text if float(text) else text.lstrip("-")


def to_error(value: float, error: float, most: int = 4) -> str:
    """A value with the decimals that its error allows, at the most `most`."""
    if not (math.isfinite(value) and math.isfinite(error) and error > 0.0):
        return number(value)
    text = f"{value:.{decimals(error, most=most)}f}"
    return text if float(text) else text.lstrip("-")


def unsigned(value: float, error: float) -> str:
    """A value with its error, of which two digits are shown."""
    text = to_error(value, error)
    if not (math.isfinite(value) and math.isfinite(error) and error > 0.0):
        return text
    return f"{text} ± {to_error(error, error)}"


def plus_minus(value: float, error: float) -> str:
    """A difference, with its sign, and its error, of which two digits are shown."""
    text = unsigned(value, error)
    known = math.isfinite(value) and math.isfinite(error) and value > 0.0 and error > 0.0
    return f"+{text}" if known and float(text.partition(" ")[0]) > 0.0 else text


def percent(value: float, error: float = math.nan) -> str:
    """A share in %, with its error if there is one."""
    return unsigned(100.0 * value, 100.0 * error)


def signed(value: float) -> str:
    """A percentage with its sign, and a decimal where that matters."""
    return f"{value:+.{0 if abs(value) >= 9.95 else 1}f}"


def share(value: float, interval: tuple[float, float]) -> str:
    """A share in %, with its interval."""
    if not math.isfinite(value):
        return NONE
    return f"{100.0 * value:.0f} ({100.0 * interval[0]:.0f}-{100.0 * interval[1]:.0f})"


def p_value(p: float) -> str:
    """A p-value as papers print it."""
    if not math.isfinite(p):
        return NONE
    return "< .001" if p < 0.001 else f"{p:.3f}".lstrip("0")


#: Standard deviations on either side of the mean that hold 95 % of a normal distribution.
Z95 = 1.959963984540054
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
    return _generator(seed, crc32(scenario.encode()), replication, crc32(method.encode()))


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
