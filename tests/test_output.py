"""Estimates in words, tables and JSON, on numbers that can be worked out by hand."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from pilotid.estimate.estimate import Estimate, Outcome, failed, symmetric_intervals
from pilotid.estimate.quantities import FrequencyResponse, Quantity
from pilotid.model.catalogue import MODELS, SINGLE
from pilotid.support.disk import strict_json


def estimate(method: str = "mine", **fields: object) -> Estimate:
    """Gain 0.5 +- 0.1 and lead 2 +- 0.3, correlated at -0.9; the rest known to 0.01."""
    error = np.array([0.1, 0.3, 0.01, 0.01, 0.01])
    correlation = np.eye(5)
    correlation[0, 1] = correlation[1, 0] = -0.9
    covariance = correlation * np.outer(error, error)
    values = np.array([0.5, 2.0, 0.3, 12.0, 0.2])
    intervals = symmetric_intervals(values, covariance)
    return Estimate(
        method,
        SINGLE,
        Outcome.CONVERGED,
        values,
        covariance,
        intervals,
        vaf=80.0,
        **fields,  # type: ignore[arg-type]
    )


def test_product_of_gain_and_lead_by_the_delta_method() -> None:
    (product,) = estimate().derived
    assert (product.key, product.unit, product.value) == ("Kvis*tlead", "s", 1.0)
    # (2 * .1)^2 + (.5 * .3)^2 + 2 * 2 * .5 * (-.9 * .1 * .3) = .04 + .0225 - .054 = .0085
    assert product.std_error == pytest.approx(math.sqrt(0.0085))
    assert product.upper - product.lower == pytest.approx(2.0 * 1.96 * math.sqrt(0.0085), rel=1e-4)


def test_sums_of_delays_by_the_delta_method() -> None:
    model = MODELS["look-ahead"]
    values = model.vector(
        {"Kt": 1.0, "tlook": 0.3, "Kvis": 1.0, "tlag": 0.4, "tdvis": 0.2, "fnm": 9.0, "dnm": 0.5}
    )
    covariance = np.diag(np.full(7, 0.04**2))
    i, j = (model.index[key] for key in ("tlook", "tdvis"))
    covariance[i, j] = covariance[j, i] = -0.5 * 0.04**2
    intervals = symmetric_intervals(values, covariance)
    found = Estimate("mine", model, Outcome.CONVERGED, values, covariance, intervals)
    assert found["tlook+tdvis"].value == pytest.approx(0.5)
    assert found["tlook+tdvis"].std_error == pytest.approx(0.04)  # (1 + 1 - 2 * .5)^(1/2) * .04
    assert found["tdvis+tlag"].value == pytest.approx(0.6)
    assert found["tdvis+tlag"].std_error == pytest.approx(0.04 * math.sqrt(2.0))
    assert "tdvis+tlag" in found.to_dict()["derived"]


@pytest.mark.parametrize(
    ("value", "error", "text", "interval"),
    [
        (0.17123, 0.0312, "0.171 ± 0.031", "0.110 .. 0.232"),
        (11.94, 1.2, "11.9 ± 1.2", "9.6 .. 14.3"),
        (1234.0, 150.0, "1234 ± 150", "940 .. 1528"),
        (0.5, math.nan, "0.5", ""),
        (0.5, 0.0, "0.5", ""),
        (math.nan, math.nan, "-", ""),
    ],
)
def test_figures_have_the_digits_that_the_error_allows(
    value: float, error: float, text: str, interval: str
) -> None:
    quantity = Quantity("k", "", value, error, value - 1.96 * error, value + 1.96 * error)
    assert quantity.shown() == (text, interval)


def test_a_wide_interval_or_one_at_a_bound_is_not_determined() -> None:
    # fnm reaches beyond its bounds, dnm spans a factor of 11, the visual gain one of 9.
    intervals = np.array([[0.1, 0.9], [1.4, 2.6], [0.29, 0.31], [-450.0, 480.0], [0.1, 1.1]])
    found = replace(estimate(), intervals=intervals)
    flags = [found[key].determined for key in ("Kvis", "tlead", "tdvis", "fnm", "dnm")]
    assert flags == [True, True, True, False, False]
    assert [entry["determined"] for entry in found.to_dict()["parameters"].values()] == flags
    assert list(found.table()["determined"])[:5] == flags
    assert found["fnm"].shown() == ("not determined", "-450 .. 480")
    assert "±" not in next(line for line in str(found).splitlines() if line.startswith("fnm"))


def test_json_of_a_failure_is_null_where_there_is_no_number() -> None:
    text = strict_json(failed("x", SINGLE, Outcome.NEGATIVE_DELAY).to_dict())
    entry = json.loads(text)
    assert "NaN" not in text
    assert entry["outcome"] == "negative-delay"
    assert entry["parameters"]["tlead"] == {
        "value": None,
        "std_error": None,
        "interval_95": [None, None],
        "unit": "s",
        "determined": False,
    }
    assert entry["correlation"] == [[None] * 5] * 5
    assert entry["starts"] is None


def test_json_of_an_estimate() -> None:
    entry = estimate(seconds=0.5).to_dict()
    assert list(estimate().parameters[0].__dict__.values())[:4] == ["Kvis", "", 0.5, 0.1]
    assert json.loads(strict_json(entry))["correlation"][0][1] == pytest.approx(-0.9)
    assert "frequency_response" not in entry


def test_json_of_a_two_step_method_holds_its_frequency_response() -> None:
    response = FrequencyResponse(
        np.array([1.0, 2.0]),
        np.array([[1 + 2j, 3.0]]),
        np.diag([0.09, 0.02, 0.16, 0.02]),
        systematic=np.array([[0.1, 0.0]]),
        note="some words",
    )
    found = replace(estimate(), frequency_response=response)
    assert found.to_dict()["frequency_response"] == {
        "omega": [1.0, 2.0],
        "note": "some words",
        "visual": {
            "real": [1.0, 3.0],
            "imag": [2.0, 0.0],
            "std": [0.5, 0.2],
            "systematic": [0.1, 0.0],
        },
    }
    assert "some words" in found.verdict()


# ------------------------------------------------------------------- results that speak


def test_an_estimate_gives_its_quantities_by_key() -> None:
    own = estimate()
    gain = own["Kvis"]
    assert (gain.value, gain.std_error, gain.interval) == (0.5, 0.1, (gain.lower, gain.upper))
    assert own["Kvis*tlead"] == own.derived[0]
    assert str(own["tlead"]).startswith("tlead = 2.00 ± 0.30 s, 95 % ")
    with pytest.raises(KeyError, match="Kvest: the estimate has Kvis, tlead"):
        own["Kvest"]


def test_a_data_frame_has_a_row_for_each_quantity() -> None:
    pytest.importorskip("pandas")
    frame = estimate().table()
    assert list(frame.columns) == [
        "parameter", "unit", "value", "std_error", "lower_95", "upper_95", "determined",
    ]  # fmt: skip
    assert list(frame["parameter"]) == [*SINGLE.keys, "Kvis*tlead"]
    assert frame["value"][0] == 0.5
