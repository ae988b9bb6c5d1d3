"""What is minimised for the pilots of a design, from what a user names."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from pilotid.designing.loop import Loop
from pilotid.designing.optimum import Criterion, Goal, Kind, Over
from pilotid.types import FloatArray, InputError


def _weights(minimise: str, keys: Sequence[str]) -> FloatArray:
    """Weights of the variances."""
    if minimise in ("A", "D", "E"):
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


def _criterion(
    loop: Loop, unit: FloatArray, weights: FloatArray, kind: Kind = "A", scale: float = 1.0
) -> Criterion:
    information = loop.information
    return Criterion(
        kind,
        information.runs * information.base,
        math.sqrt(information.runs) * information.factors * np.sqrt(unit)[:, None, None],
        weights,
        scale,
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
    kind: Kind = "D" if minimise == "D" else "E" if minimise == "E" else "A"
    found = []
    for loop, reference in zip(loops, references, strict=True):
        before = _criterion(reference, np.ones(usual.size), weights, kind, float(kind != "D"))
        found.append(_criterion(loop, unit, weights, kind, before.value(usual)))
    return found


def goal_of(
    minimise: str,
    wanted: Mapping[str, float],
    loops: Sequence[Loop],
    references: Sequence[Loop],
    usual: FloatArray,
    unit: FloatArray,
    over: Over,
) -> Goal:
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
        return Goal(_wishes(wanted, loops, unit), "worst")
    return Goal(_criteria(minimise, loops, references, usual, unit), over)


def _wishes(
    wanted: Mapping[str, float], loops: Sequence[Loop], unit: FloatArray
) -> list[Criterion]:
    """Variance over that wished for, of each parameter and pilot."""
    keys = loops[0].scenario.model.keys
    _require_keys(list(wanted), keys)
    return [
        _criterion(loop, unit, np.eye(len(keys))[keys.index(key)], scale=share**2)
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
    values = [c.value(loop.told(powers)) for c, loop in zip(criteria, loops, strict=True)]
    return tuple(math.exp(0.5 * v) if minimise == "D" else math.sqrt(v) for v in values)
