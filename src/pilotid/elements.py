"""Controlled elements from a text such as ``4/s^2``."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

from pilotid.controlled import (
    ControlledElement,
    double_integrator,
    integrator_with_lag,
    position_control,
    single_integrator,
)
from pilotid.types import InputError

_NUMBER = r"([0-9]*\.?[0-9]+(?:e[-+]?[0-9]+)?)"
_FORMS: tuple[tuple[str, Callable[..., ControlledElement]], ...] = (
    (_NUMBER, position_control),
    (rf"{_NUMBER}/s", single_integrator),
    (rf"{_NUMBER}/s(?:\^|\*\*)2", double_integrator),
    (rf"{_NUMBER}/\(s\*?\(s\+{_NUMBER}\)\)", integrator_with_lag),
)


def parsed_element(text: str) -> ControlledElement | None:
    """The controlled element K, K/s, K/s^2 or K/(s(s+a)) of a text; None for any other."""
    plain = re.sub(r"\s", "", text).lower()
    for form, build in _FORMS:
        match = re.fullmatch(form, plain)
        if match:
            numbers = [float(group) for group in match.groups()]
            return build(*numbers) if all(0.0 < n < math.inf for n in numbers) else None
    return None


def element_named(text: str) -> ControlledElement:
    """As `parsed_element`; `InputError` for a text that is none."""
    element = parsed_element(text)
    if element is None:
        raise InputError(
            f"the controlled element '{text}' is not one of K, K/s, K/s^2 and K/(s(s+a)) with "
            "positive numbers; write for example 4/s^2"
        )
    return element
