"""Whether an estimate agrees with another way to estimate, from the same recording."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from pilotid.support.limits import ESTIMATE
from pilotid.support.remarks import Grade, Remark
from pilotid.support.types import FloatArray


@dataclass(frozen=True)
class Specification:
    """A test of an estimate against another.

    Attributes
    ----------
    statistic, p_value
        The test, and how probable one as large is if the estimate is right.
    against
        The method whose equations it is held against.
    """

    statistic: float
    p_value: float
    against: str

    @property
    def agrees(self) -> bool:
        """Whether the two agree."""
        return self.p_value >= ESTIMATE.misspecified

    @property
    def sentence(self) -> str:
        """The test in words."""
        return (
            f"specification: {'agrees' if self.agrees else 'disagrees'} with {self.against} "
            f"(difference {'not ' if self.agrees else ''}significant, p = {self.p_value:.2g})"
        )

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """What to say of an estimate that disagrees."""
        if self.agrees:
            return ()
        grade: Grade = "wrong" if self.p_value < ESTIMATE.surely_misspecified else "doubt"
        return (
            Remark(
                "misspecified",
                f"the estimate contradicts the forcing functions (p = {self.p_value:.1g}): the "
                f"model or the recording is not as the method assumes; fit with {self.against} as "
                "well, and do not use what differs",
                grade,
            ),
        )

    def to_dict(self) -> dict[str, object]:
        """Plain objects."""
        return {**asdict(self), "agrees": self.agrees}


def score_test(score: FloatArray, shares: FloatArray, against: str) -> Specification | None:
    """Hausman's test by independent scores, which have mean zero if an estimate is right.

    Parameters
    ----------
    score
        Scores in units of what they scatter by at the true parameters, shape (directions,).
    shares
        Share of that variance that is left at the estimate, from 0 to 1, shape (directions,).
    against
        The method whose equations they are of.
    """
    from scipy.special import gammaincc

    # What the estimate has made use of scatters by less than its share; and the covariance is
    # itself an estimate, so that no direction scatters by less than a certain part.
    part = ESTIMATE.covariance
    scatter = part + (1.0 - part) * np.clip(shares, 0.0, 1.0) ** 2
    statistic = float(np.sum(score**2 / scatter))
    if not math.isfinite(statistic):
        return None
    return Specification(statistic, float(gammaincc(0.5 * score.size, 0.5 * statistic)), against)
