"""Numbers as plain text: how many digits; pages set the signs of print."""

from __future__ import annotations

import math

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
