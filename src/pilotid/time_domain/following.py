"""Whether a fit follows the control as a pilot does.

The likelihood of the whole control has optima without a pilot in them.  What acts on error or
output can also be the inverse of the controlled element, x = Hc (u + fd), which predicts the
control but for the forcing functions; and these are smooth, so that a model of the remnant
predicts them in turn, the better the wider the band.  Such a fit has a likelihood beyond that
of any pilot, and its simulated response explains little or nothing of the control.  The pilot
who is fitted to the forcing functions' lines alone tells how much there is to explain.
"""

from __future__ import annotations

import numpy as np

from pilotid.solve.least_squares import Minima
from pilotid.time_domain.output_error import OutputErrors
from pilotid.time_domain.prediction import Prediction
from pilotid.types import BoolArray, FloatArray, IntArray

#: A pilot's simulated response explains at least this share of what that of the lines' pilot does;
#: in populations what is right has .90 or more, what has slid to the inverse -100 to .84.
LESS = 0.8


class Following:
    """Whether parameters follow the control, as the pilot that the lines show does.

    Parameters
    ----------
    coarse
        The prediction at few frequencies.
    known
        Pilots of whom the first is that one, shape (sets, parameters); None if there are no
        lines: then all parameters follow.
    """

    def __init__(self, coarse: Prediction, known: FloatArray | None) -> None:
        self._errors = OutputErrors(coarse)
        self._pilot = len(coarse.model.parameters)
        self._total = float(np.sum(coarse.samples_of(coarse.control_spectrum) ** 2))
        self.lines = 0.0 if known is None else float(self.explained(known[:1])[0])

    def explained(self, sets: FloatArray) -> FloatArray:
        """Share of the control that simulated responses explain, shape (sets,).

        Parameters
        ----------
        sets
            Parameters, the pilot's first, shape (sets, parameters).
        """
        left = self._errors.gram(sets[:, : self._pilot])[:, -1, -1]
        return np.asarray(1.0 - left / self._total)

    def __call__(self, sets: FloatArray) -> BoolArray:
        """Which parameters do, the pilot's first, shape (sets,)."""
        if self.lines <= 0.0:
            return np.ones(len(sets), dtype=bool)
        return np.asarray(self.explained(sets) >= LESS * self.lines)

    def which(self, ends: Minima) -> IntArray:
        """Indices of the ends that do, of all if none does."""
        kept = self(ends.values)
        return np.flatnonzero(kept if kept.any() else ~kept)

    def only(self, ends: Minima) -> Minima:
        """The ends that do, all if none does."""
        which = self.which(ends)
        return ends if len(which) == len(ends.cost) else ends.only(which)
