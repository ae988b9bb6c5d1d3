"""Whether an estimate agrees with another way to estimate, from the same recording."""

from __future__ import annotations

from dataclasses import dataclass

from pilotid.remarks import Remark

#: p-value below which an estimate disagrees.
LEVEL = 1e-4


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
    against: str = "fourier"

    @property
    def agrees(self) -> bool:
        """Whether the two agree."""
        return self.p_value >= LEVEL

    @property
    def sentence(self) -> str:
        """The test in words."""
        return (
            f"specification: {'agrees' if self.agrees else 'disagrees'} with {self.against} "
            f"(p = {self.p_value:.2g})"
        )

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """What to say of an estimate that disagrees."""
        if self.agrees:
            return ()
        return (
            Remark(
                "misspecified",
                f"the lines of the forcing functions say otherwise (p = {self.p_value:.1g}): the "
                f"model, or the recording, is not what the method takes it for; set {self.against} "
                "beside it, and do not believe what differs",
            ),
        )

    def to_dict(self) -> dict[str, object]:
        """Plain objects."""
        return {
            "statistic": self.statistic,
            "p_value": self.p_value,
            "against": self.against,
            "agrees": self.agrees,
        }
