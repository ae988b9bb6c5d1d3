"""Numbers as words: how many digits, which signs."""

from __future__ import annotations

import math

NONE = "\N{EN DASH}"
MINUS = "\N{MINUS SIGN}"


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
    return text.replace("-", MINUS) if float(text) else text.lstrip("-")


def plus_minus(value: float, error: float) -> str:
    """A value with its error, of which two digits are shown."""
    if not math.isfinite(value):
        return NONE
    if not (math.isfinite(error) and error > 0.0):
        return number(value)
    places = decimals(error, most=4)
    text = f"{value:+.{places}f}"
    text = text.replace("-", MINUS) if float(text) else text[1:]
    return f"{text} ± {error:.{places}f}"


def signed(value: float) -> str:
    """A percentage with its sign, a decimal where that matters and a true minus."""
    return printed(value, 0 if abs(value) >= 9.95 else 1)


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
