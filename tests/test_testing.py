"""The contract test for methods of other packages finds what is wrong with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from pilotid.estimate.estimate import Estimate, Outcome, failed
from pilotid.methods.mle_white import MLEWhite
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.testing import check_method

pytestmark = pytest.mark.numerical

GENERATOR = np.random.default_rng(1)  # nobody passes it


@dataclass(frozen=True)
class Own(MLEWhite):
    """Changes the estimate of another method."""

    change: Callable[[Estimate, np.random.Generator], Estimate] | None = None
    name: ClassVar[str] = "own"

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        good = replace(super().fit(recording, model, rng), method="own")
        return self.change(good, rng) if self.change else good


def signed(good: Estimate, rng: np.random.Generator) -> Estimate:
    return replace(good, method="another")


def reversed_order(good: Estimate, rng: np.random.Generator) -> Estimate:
    order = np.arange(good.values.size)[::-1]
    return replace(
        good,
        values=good.values[order],
        covariance=good.covariance[order][:, order],
        intervals=good.intervals[order],
    )


def chance(good: Estimate, rng: np.random.Generator) -> Estimate:
    shift = 1e-3 * GENERATOR.random() * good.values
    return replace(good, values=good.values + shift, intervals=good.intervals + shift[:, None])


def helpless(good: Estimate, rng: np.random.Generator) -> Estimate:
    return failed("own", good.model, Outcome.NOT_CONVERGED)


def picky(good: Estimate, rng: np.random.Generator) -> Estimate:
    if good.vaf < 20.0:
        raise ValueError("what is this?")
    return good


@dataclass
class Loose:
    """Keeps what it likes."""

    name: str = "loose"

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        return None

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        raise NotImplementedError


def test_a_good_method_passes() -> None:
    check_method(Own())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (signed, "own: signs its estimates with 'another'"),
        (reversed_order, "far from the truth; are values in order"),
        (chance, "gives other values with the same random generator"),
        (helpless, "finds nothing in an ordinary recording"),
        (picky, "ValueError: what is this"),
        (lambda good, rng: good, "cannot be hashed and pickled"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_a_bad_method_is_told_what_is_wrong(
    change: Callable[[Estimate, np.random.Generator], Estimate], words: str
) -> None:
    with pytest.raises(AssertionError, match=words):
        check_method(Own(change=change), models=["single"])


def test_what_is_no_method_is_told_so() -> None:
    with pytest.raises(AssertionError, match="needs a `name`"):
        check_method(object())  # type: ignore[arg-type]
    with pytest.raises(AssertionError, match="loose: must be a frozen dataclass"):
        check_method(Loose())
