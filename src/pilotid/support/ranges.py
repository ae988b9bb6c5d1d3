"""Ranges of the numbers that users give, on the command line, in Python and as settings."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from functools import wraps
from numbers import Number, Real
from typing import NamedTuple, ParamSpec, TypeVar

from pilotid.support.types import InputError

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
BAND, SHARE, FEW = Range(1.0, 1e4), Range(0.0, 1.0), Range(1, 1000, True)
#: Settings of the methods of this package.
SETTINGS = {
    "band": BAND,
    "search_band": BAND,
    "lowest": Range(0.01, 1e3),
    "highest": Range(1.0, 1e3),
    "memory": Range(0.1, 1000.0),
    "longest_delay": Range(0.01, 5.0),
    "delays": Range(0.0, 5.0),
    "window": Range(1.0, 1e4),
    "step": Range(0.1, 1e4),
    "block": Range(0.1, 100.0),
    "misfit": SHARE,
    "removed": SHARE,
    "threshold": SHARE,
    "tolerance": Range(1e-12, 1.0),
    "damping": Range(1e-12, 1e3),
    "pade_order": Range(1, 10, True),
    "poles": Range(1, 40, True),
    "zeros": Range(1, 40, True),
    "long_poles": Range(1, 100, True),
    "own_lags": Range(1, 40, True),
    "trend": Range(0, 10, True),
    "draws": Range(1, 10**6, True),
    "wanted": Range(1.0, 1e5),
    **dict.fromkeys(("points", "rounds", "candidates", "refined", "members", "kept"), FEW),
    **dict.fromkeys(("population", "generations", "iterations", "neighbours"), FEW),
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
    if not (dataclasses.is_dataclass(thing) and type(thing).__module__.startswith("pilotid.")):
        return
    for field in dataclasses.fields(thing):
        given, known = getattr(thing, field.name), SETTINGS.get(field.name)
        for value in given if isinstance(given, tuple | list) else (given,):
            if known is not None and value is not None:
                in_range(value, known, field.name)
