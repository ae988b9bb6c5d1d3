"""What a design gives when the pilot is not the one it was made for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pilotid.designing.design import Design
from pilotid.designing.loop import loop_of, powers_of, with_held_remnant
from pilotid.types import FloatArray, InputError

OFF = 0.25  # share by which one parameter is another


class Wrong(NamedTuple):
    """A pilot with one other parameter.

    Attributes
    ----------
    key, share
        The parameter, and by what share it differs.
    errors
        Standard errors over those with the reference's forcing functions, (parameters,);
        None where the loop is unstable.
    error_cost, control_cost
        Variances of e and u over those with the reference's forcing functions.
    """

    key: str
    share: float
    errors: FloatArray | None
    error_cost: float
    control_cost: float


def wrong_pilots(made: Design) -> Iterator[Wrong]:
    """Each parameter lower and higher, the remnant as the design takes it."""
    reference = with_held_remnant(made.reference)
    keys = reference.model.keys
    usual = powers_of(reference)
    known = made.references[0].lines
    for i, key in enumerate(keys):
        for share in (-OFF, OFF):
            truth = np.array(reference.truth)
            truth[i] *= 1.0 + share
            pilot = replace(reference, truth=tuple(truth.tolist()))
            try:
                before, after = loop_of(pilot, known), loop_of(pilot, made.lines)
            except InputError:
                yield Wrong(key, share, None, np.nan, np.nan)
                continue
            if made.remnant == "share":
                control = before.variance("u", usual)
                before, after = before.sharing(control), after.sharing(control)
            costs = (after.variance(s, made.powers) / before.variance(s, usual) for s in "eu")
            ratio = after.errors(made.powers) / before.errors(usual)
            yield Wrong(key, share, ratio, *costs)
