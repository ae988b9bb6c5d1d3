"""Numbers: their ranges, what chance allows, and random generators."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from functools import wraps
from numbers import Number, Real
from typing import NamedTuple, ParamSpec, TypeVar
from zlib import crc32

import numpy as np

from pilotid.support.types import InputError

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


P = ParamSpec("P")
T = TypeVar("T")


class Range(NamedTuple):
    """What a number may be, both ends included."""

    low: float
    high: float
    whole: bool = False


SEED = Range(0, 2**64 - 1, True)
#: Arguments and options; more takes days, or more memory than there is, and tells no more.
ARGUMENTS = {
    "seed": SEED,
    "rng": SEED,
    "replications": Range(1, 10**6, True),
    "workers": Range(1, 256, True),
    "runs": Range(1, 1000, True),
    "lead_in": Range(0.0, 3600.0),
    "dt": Range(1e-5, 1.0),
    "time_limit": Range(0.0, 1e7),
}
RUNS = (True, "runs")  # as a text they are chosen, such as 2-5
#: Settings of the methods of this package: whole numbers, and others.
COUNT, SIZE = Range(1, 1000, True), Range(1e-12, 1e6)
#: Those of other ranges.
SETTINGS = {
    **dict.fromkeys(("misfit", "removed", "threshold"), Range(0.0, 1.0)),
    "delays": Range(0.0, 5.0),
    "trend": Range(0, 10, True),
    "pade_order": Range(1, 10, True),
    "most": Range(1, 10**6, True),
}


def in_range(value: object, known: Range, name: str) -> float:
    """A number that is one and in its range, as Python's own.

    Raises
    ------
    InputError
        If it is not; the sentence begins with the name.
    """
    what = "a whole number" if known.whole else "a number"
    if isinstance(value, int | float | Real) and value is not True and value is not False:
        number = float(value)
        if known.low <= number <= known.high and (number.is_integer() or not known.whole):
            return int(value if isinstance(value, int) else number) if known.whole else number
    shown = f"{value:g}" if isinstance(value, float) else f"{value!r:.50}"
    raise InputError(f"{name} {shown}: must be {what} from {known.low:g} to {known.high:g}")


def ranged(function: Callable[P, T], spelled: Callable[[str], str] = str) -> Callable[P, T]:
    """A function that refuses arguments out of the ranges of their names.

    Parameters
    ----------
    function
        The function; arguments that are neither numbers nor texts are its own affair.
    spelled
        How users write an argument's name.
    """
    signature = inspect.signature(function)

    @wraps(function)
    def careful(*arguments: P.args, **named: P.kwargs) -> T:
        for name, value in signature.bind(*arguments, **named).arguments.items():
            known = ARGUMENTS.get(name)
            text = isinstance(value, str)
            if known is None or not (text or isinstance(value, Number)) or (text, name) == RUNS:
                continue
            in_range(value, known, spelled(name))
        return function(*arguments, **named)

    return careful


def require_settings(thing: object) -> None:
    """Refuse settings of a method of this package that are out of their ranges."""
    if not (dataclasses.is_dataclass(thing) and type(thing).__module__.startswith("pilotid.meth")):
        return
    for field in dataclasses.fields(thing):
        given = getattr(thing, field.name)
        for value in given if isinstance(given, tuple | list) else (given,):
            if isinstance(value, int | float) and not isinstance(value, bool):
                usual = COUNT if "int" in str(field.type) else SIZE
                in_range(value, SETTINGS.get(field.name, usual), field.name)
