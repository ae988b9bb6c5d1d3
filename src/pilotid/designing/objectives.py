"""What is minimised for the pilots of a design, from what a user names."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from pilotid.designing.goals import AnyGoal, Criterion, LongestAxis, Mean, Worst
from pilotid.designing.loop import Loop
from pilotid.types import FloatArray, InputError

Over = Literal["mean", "worst"]


def _weights(minimise: str, keys: Sequence[str]) -> FloatArray | None:
    """Weights of the variances, None for criterion D."""
    if minimise == "D":
        return None
    if minimise in ("A", "E"):
        return np.full(len(keys), 1.0 / len(keys))
    named = [key.strip() for key in minimise.split(",")]
    _require_keys(named, keys)
    return np.array([named.count(key) / len(named) for key in keys])


def _require_keys(named: Sequence[str], keys: Sequence[str]) -> None:
    unknown = [key for key in named if key not in keys]
    if unknown:
        raise InputError(
            f"there is no parameter '{unknown[0]}' to make small: choose from {', '.join(keys)}, "
            "or A, D or E"
        )


def _criterion(loop: Loop, unit: FloatArray, weights: FloatArray | None) -> Criterion:
    information = loop.information
    return Criterion(
        information.runs * information.base,
        math.sqrt(information.runs) * information.factors * np.sqrt(unit)[:, None, None],
        weights,
        1.0 if weights is not None else 0.0,
    )


def _criteria(
    minimise: str,
    loops: Sequence[Loop],
    references: Sequence[Loop],
    usual: FloatArray,
    unit: FloatArray,
) -> list[Criterion]:
    """The criterion of each pilot, in units of its value with the reference."""
    weights = _weights(minimise, loops[0].scenario.model.keys)
    found = []
    for loop, reference in zip(loops, references, strict=True):
        before = _criterion(reference, np.ones(usual.size), weights)
        if minimise == "E":
            scale = 1.0 / float(np.linalg.eigvalsh(before.information(usual))[0])  # a variance
        else:
            scale = before.value(usual)
        found.append(replace(_criterion(loop, unit, weights), scale=scale))
    return found


def goal_of(
    minimise: str,
    wanted: Mapping[str, float],
    loops: Sequence[Loop],
    references: Sequence[Loop],
    usual: FloatArray,
    unit: FloatArray,
    over: Over,
) -> AnyGoal:
    """The goal of a design.

    Parameters
    ----------
    minimise, wanted, over
        See `pilotid.designing.design.design`.
    loops, references
        One for each pilot, with the lines of the design and those of the reference.
    usual
        Powers of the reference, shape (reference's lines,).
    unit
        Power of each line that counts as 1, shape (lines,).
    """
    if wanted:
        return Worst(_wishes(wanted, loops, unit))
    criteria = _criteria(minimise, loops, references, usual, unit)
    if minimise == "E":
        return LongestAxis(criteria, over if len(loops) > 1 else "worst")
    return Worst(criteria) if over == "worst" and len(loops) > 1 else Mean(criteria)


def _wishes(
    wanted: Mapping[str, float], loops: Sequence[Loop], unit: FloatArray
) -> list[Criterion]:
    """Variance over that wished for, of each parameter and pilot."""
    keys = loops[0].scenario.model.keys
    _require_keys(list(wanted), keys)
    return [
        replace(_criterion(loop, unit, np.eye(len(keys))[keys.index(key)]), scale=share**2)
        for loop in loops
        for key, share in wanted.items()
    ]


def gains_of(
    minimise: str,
    wanted: Mapping[str, float],
    loops: Sequence[Loop],
    references: Sequence[Loop],
    usual: FloatArray,
    powers: FloatArray,
) -> tuple[float, ...]:
    """Each pilot's objective over that with the reference, in terms of errors."""
    if wanted:
        one, ones = np.ones(powers.size), np.ones(usual.size)
        count = len(wanted)
        told = [loop.told(powers) for loop in loops for _ in wanted]
        after = [c.value(t) for c, t in zip(_wishes(wanted, loops, one), told, strict=True)]
        before = [c.value(usual) for c in _wishes(wanted, references, ones)]
        pairs = [
            (max(after[i : i + count]), max(before[i : i + count]))
            for i in range(0, len(after), count)
        ]
        return tuple(math.sqrt(a / b) for a, b in pairs)
    criteria = _criteria(minimise, loops, references, usual, np.ones(powers.size))
    each = [LongestAxis([c]) if minimise == "E" else c for c in criteria]
    values = [c.value(loop.told(powers)) for c, loop in zip(each, loops, strict=True)]
    return tuple(math.exp(0.5 * v) if minimise == "D" else math.sqrt(v) for v in values)
