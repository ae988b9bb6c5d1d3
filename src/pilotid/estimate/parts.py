"""Parts of an estimate: its band, the remnant, frequency responses, the test of its model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from pilotid.support.limits import ESTIMATE
from pilotid.support.numbers import LEVEL
from pilotid.support.remarks import Grade, Remark
from pilotid.support.types import ComplexArray, FloatArray

EMPTY = np.zeros(0)


def plain_fields(thing: Any) -> dict[str, object]:
    """The fields of a dataclass, arrays as lists."""
    values = ((f.name, getattr(thing, f.name)) for f in fields(thing))
    return {name: v.tolist() if isinstance(v, np.ndarray) else v for name, v in values}


@dataclass(frozen=True, eq=False)
class AnalysedBand:
    """What was analysed.

    Attributes
    ----------
    highest
        Frequency up to which the recording was used [rad/s].
    likelihood
        ``band`` if the likelihood has the loop's term, ``direct`` for direct prediction errors,
        empty for methods that maximise none.
    omega, weights
        Frequencies [rad/s] and the weight of a bin there, shape (n,); empty if all weigh the same.
    floors
        Power density of what the recorder adds, by signal [the unit of the signal squared s/rad].
    element
        The controlled element that closes the loop; empty for none.
    """

    highest: float
    likelihood: str = ""
    omega: FloatArray = field(default_factory=lambda: EMPTY)
    weights: FloatArray = field(default_factory=lambda: EMPTY)
    floors: Mapping[str, float] = field(default_factory=dict)
    element: str = ""

    @property
    def half(self) -> float:
        """Frequency from which on a bin weighs less than half [rad/s]; `highest` if none does."""
        light = np.flatnonzero(self.weights < 0.5)
        return min(self.highest, float(self.omega[light[0]])) if light.size else self.highest

    @property
    def words(self) -> str:
        """What was analysed, in a few words."""
        words = f"analysed up to {self.highest:.3g} rad/s"
        if self.half < 0.95 * self.highest:
            words += f", half weight from {self.half:.3g}: the recorder's floor"
        return words

    def to_dict(self) -> dict[str, object]:
        """Plain objects, as JSON has them."""
        return {**plain_fields(self), "half_weight": self.half, "floors": dict(self.floors)}


@dataclass(frozen=True, eq=False)
class RemnantEstimate:
    """The remnant as a method saw it, inside its analysis band.

    Attributes
    ----------
    model
        Name of the noise model.
    parameters
        Its parameters by name (frequencies in rad/s).
    power_ratio
        var(n)/var(u).
    omega
        Frequencies [rad/s], shape (n,).
    density
        One-sided power spectral density [unit of u, squared, per rad/s], shape (n,).
    """

    model: str
    parameters: dict[str, float]
    power_ratio: float
    omega: FloatArray
    density: FloatArray

    @property
    def words(self) -> str:
        """It in a few words; the coefficients of a free spectrum say nothing to a reader."""
        words = f"remnant {100.0 * self.power_ratio:.1f} % of the control's power, {self.model}"
        kind = " at" if "corner" in self.parameters else " low-pass at"
        if "frequency" in self.parameters:
            words += f"{kind} {self.parameters['frequency']:.3g} rad/s"
        if "damping" in self.parameters:
            words += f", damping {self.parameters['damping']:.2g}"
        if "corner" in self.parameters:
            words += f", from {self.parameters['corner']:.2g} rad/s"
        return words


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Estimated responses of a pilot model's channels at some frequencies.

    Attributes
    ----------
    omega
        Frequencies [rad/s], ascending, shape (n,).
    value
        Response of every channel without its sign, so that u = visual e - vestibular x;
        complex, shape (channels, n).
    covariance
        Covariance of the real parts and then the imaginary parts of `value`, each channel
        by channel; shape (2 channels n, 2 channels n).
    systematic
        Size of errors that are not random, those of an interpolation as a fitted model has them,
        shape (channels, n).  The covariance has what the bends of the responses say of them.
    note
        What a reader should know of it, for messages and reports.
    """

    omega: FloatArray
    value: ComplexArray
    covariance: FloatArray
    systematic: FloatArray | None = None
    note: str = ""

    @property
    def std(self) -> FloatArray:
        """Root mean square of the random error, of value less true value, (channels, n)."""
        real, imaginary = np.diag(self.covariance).reshape(2, *self.value.shape)
        return np.asarray(np.sqrt(real + imaginary))

    def to_dict(self, names: Sequence[str]) -> dict[str, object]:
        """Plain objects, as JSON has them, with the channels by these names."""
        result: dict[str, object] = {"omega": self.omega.tolist()}
        result |= {"note": self.note} if self.note else {}
        parts = {"real": self.value.real, "imag": self.value.imag, "std": self.std}
        parts |= {} if self.systematic is None else {"systematic": self.systematic}
        for c, name in enumerate(names):
            result[name] = {part: values[c].tolist() for part, values in parts.items()}
        return result


def real_parts(value: ComplexArray) -> FloatArray:
    """Real and then imaginary parts of responses, in the order of the covariance.

    Parameters
    ----------
    value
        Responses, shape (..., channels, n).

    Returns
    -------
    Array of shape (..., 2 channels n).
    """
    parts = np.stack([value.real, value.imag], axis=-3)
    return parts.reshape(*value.shape[:-2], -1)


def circular(covariance: ComplexArray) -> FloatArray:
    """Covariance of real and imaginary parts of errors whose phase is random.

    Parameters
    ----------
    covariance
        E[z z^H] of the complex errors z, shape (m, m).

    Returns
    -------
    Array of shape (2 m, 2 m), real parts first.
    """
    real, imaginary = covariance.real, covariance.imag
    return 0.5 * np.block([[real, -imaginary], [imaginary, real]])


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
        p = f"{self.against} (p = {self.p_value:.2g})"
        if not self.agrees:
            return f"specification: contradicts {p}"
        if self.p_value < LEVEL:
            return f"specification: differs at the 5 % level, but not clearly, from {p}"
        return f"specification: no significant difference from {p}"

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """What to say of an estimate that disagrees."""
        if self.agrees:
            return ()
        grade: Grade = "wrong" if self.p_value < ESTIMATE.surely_misspecified else "doubt"
        sentence = (
            f"the estimate contradicts the forcing functions (p = {self.p_value:.1g}): the model "
            f"or the recording is not as the method assumes; fit with {self.against} as well, and "
            "do not use what differs"
        )
        return (Remark("misspecified", sentence, grade),)

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
    from scipy.special import fdtrc

    # What the estimate has made use of scatters by less than its share; and the covariance is
    # itself an estimate, so that no direction scatters by less than a certain part.
    part = ESTIMATE.covariance
    scatter = part + (1.0 - part) * np.clip(shares, 0.0, 1.0) ** 2
    statistic = float(np.sum(score**2 / scatter))
    if not math.isfinite(statistic):
        return None
    # With variances that are estimated the statistic is F's (Hotelling), not chi-squared.
    p_value = float(fdtrc(score.size, ESTIMATE.score_freedom, statistic / score.size))
    return Specification(statistic, p_value, against)
