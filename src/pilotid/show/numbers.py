"""Numbers as the words of a study's tables."""

from __future__ import annotations

import math

from pilotid.estimates.quantities import Quantity

NONE = "\N{EN DASH}"
MINUS = "\N{MINUS SIGN}"


def number(value: float, digits: int = 3) -> str:
    """A number with that many digits, without an exponent unless it is far off."""
    if not math.isfinite(value):
        return NONE
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        places = digits - 1 - math.floor(math.log10(abs(value))) if value else 0
        text = f"{value:.{min(max(places, 0), digits)}f}"
    else:
        text = f"{value:.1e}"
    return text.replace("-", MINUS) if float(text) else text.lstrip("-")


def plus_minus(value: float, error: float) -> str:
    """A value with its error, of which two digits are shown."""
    if not math.isfinite(value):
        return NONE
    if not (math.isfinite(error) and error > 0.0):
        return number(value)
    places = min(max(1 - math.floor(math.log10(error)), 0), 4)
    text = f"{value:+.{places}f}"
    text = text.replace("-", MINUS) if float(text) else text[1:]
    return f"{text} ± {error:.{places}f}"


def printed(value: float, places: int = 1) -> str:
    """A number of the paper with the decimals that it has there."""
    return f"{value:+.{places}f}".replace("-", MINUS)


def share(value: float, interval: tuple[float, float] | None = None) -> str:
    """A share in %, with its interval if there is one."""
    if not math.isfinite(value):
        return NONE
    text = f"{100.0 * value:.0f}"
    if interval is None:
        return text
    return f"{text} ({100.0 * interval[0]:.0f}{NONE}{100.0 * interval[1]:.0f})"


def decimals(error: float) -> int:
    """Decimals of a number whose error shows two digits."""
    return min(max(1 - math.floor(math.log10(error)), 0), 9)


def value_and_interval(quantity: Quantity, plus_minus: str = "±") -> tuple[str, str]:
    """Value with standard error, and 95 % interval, to the digits that the error allows."""
    if not math.isfinite(quantity.value):
        return "-", ""
    error = quantity.std_error
    if not (math.isfinite(error) and error > 0.0):
        return f"{quantity.value:.4g}", ""
    digits = decimals(error)
    value = f"{quantity.value:.{digits}f} {plus_minus} {error:.{digits}f}"
    return value, f"{quantity.lower:.{digits}f} .. {quantity.upper:.{digits}f}"
