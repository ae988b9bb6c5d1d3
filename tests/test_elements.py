"""Controlled elements as text: what is read, and how the rest is refused."""

from __future__ import annotations

import numpy as np
import pytest

from pilotid.datasets import CATALOGUE, Scenario
from pilotid.datasets.population import drawn_element
from pilotid.model.element import element_named, parsed_element
from pilotid.support.types import InputError

OMEGA = np.geomspace(0.1, 30.0, 20)
S = 1j * OMEGA


@pytest.mark.parametrize(
    ("text", "numerator", "denominator"),
    [
        ("4", (4.0,), (1.0,)),
        ("-2.5/s", (-2.5,), (1.0, 0.0)),
        ("4/s^2", (4.0,), (1.0, 0.0, 0.0)),
        (" 4 / s**2 ", (4.0,), (1.0, 0.0, 0.0)),
        ("s^-2 * 15", (15.0,), (1.0, 0.0, 0.0)),
        ("1.5e1/(s(s+2))", (15.0,), (1.0, 2.0, 0.0)),
        ("4/(s*(s-2))", (4.0,), (1.0, -2.0, 0.0)),
        ("10/(s*(s + .5))", (10.0,), (1.0, 0.5, 0.0)),
        ("64/(s^2+11s+64)", (64.0,), (1.0, 11.0, 64.0)),
        ("64/[s² + 11·s + 64]", (64.0,), (1.0, 11.0, 64.0)),
        ("Hc(s) = 4/S^2", (4.0,), (1.0, 0.0, 0.0)),
        ("(s+1)(s+2)/(s+3)^2", (1.0, 3.0, 2.0), (1.0, 6.0, 9.0)),
        ("1/s + 2/(s+3)", (3.0, 3.0), (1.0, 3.0, 0.0)),
    ],
)
def test_controlled_elements_are_read(
    text: str, numerator: tuple[float, ...], denominator: tuple[float, ...]
) -> None:
    element = element_named(text)
    assert (element.numerator, element.denominator) == (numerator, denominator)
    assert element.delay == 0.0
    assert parsed_element(element.name) == element


@pytest.mark.parametrize(
    ("text", "response"),
    [
        ("4 exp(-0.05s)/(s(1+s/30)^2)", 4.0 * np.exp(-0.05 * S) / (S * (1.0 + S / 30.0) ** 2)),
        (
            "10.62 (s + .99)/(s (s^2 + 2.58 s + 7.61))",
            10.62 * (S + 0.99) / (S * (S**2 + 2.58 * S + 7.61)),
        ),
        ("2e^(-0.1s)/s", 2.0 * np.exp(-0.1 * S) / S),
        ("e**(-s/10) * 2e-1/s", 0.2 * np.exp(-0.1 * S) / S),
        ("3exp(-.1s) exp(-.2 s)", 3.0 * np.exp(-0.3 * S)),
    ],
)
def test_responses_are_those_of_the_formula(text: str, response: np.ndarray) -> None:
    element = element_named(text)
    np.testing.assert_allclose(element.response(OMEGA), response, rtol=1e-12)
    assert parsed_element(element.name) == element


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "it is empty"),
        ("K/s^2", "'k' is no number, s or bracket"),
        ("Hc = 4,0/s", "'(4,0/s)' is no number"),
        ("4/s(s+2)", "'(s+2)' may be meant above or below"),
        ("0/s", "it is zero"),
        ("1e999", "a number is too large"),
        ("4/(s+2", "is missing at '(s+2'"),
        ("4/s^2.5", "an exponent is no whole number"),
        ("(s+1)^12/(s+2)^12/(s+1)", "powers of s above 12"),
        ("1/(s-s)", "it divides by zero"),
        ("e^-0.1s", "'e' is no number"),
        ("exp(-.1)/s", "a delay is e to a number of seconds times s"),
        ("exp(.1s)/s", "its delay is negative"),
        ("exp(-.1s)+2", "different delays"),
        ("(" * 60 + "s" + ")" * 60, "more zeros than poles"),
    ],
)
def test_other_texts_are_refused_in_a_sentence_that_shows_where(text: str, why: str) -> None:
    assert parsed_element(text) is None
    with pytest.raises(InputError, match="write for example 4/s") as refused:
        element_named(text)
    assert why in str(refused.value)
    assert "\n" not in str(refused.value)


def test_names_in_the_catalogue_are_read() -> None:
    fixed = [s.element for s in CATALOGUE.values() if isinstance(s, Scenario)]
    rng = np.random.default_rng(3)
    kinds = ("K", "K/s", "K/s^2", "K/(s(s+a))", "second order")
    for element in fixed + [drawn_element(kind, rng) for kind in kinds for _ in range(20)]:
        read = element_named(element.name)
        # Names have six digits.
        np.testing.assert_allclose(read.response(OMEGA), element.response(OMEGA), rtol=1e-4)
