"""Quantities with errors and intervals, their symbols, and the draws of a posterior."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, field, fields
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pilotid.support.format import Table, decimals, table
from pilotid.support.limits import ESTIMATE
from pilotid.support.numbers import LEVEL, Z95
from pilotid.support.remarks import Grade, Remark
from pilotid.support.types import BoolArray, ComplexArray, FloatArray

if TYPE_CHECKING:
    from arviz_base import DataTree
    from pandas import DataFrame

TAILS = (0.025, 0.975)  # quantiles at the ends of intervals

#: Symbols by key; a number behind a key becomes an index.
SYMBOLS = {
    "Kvis": "K_v",
    "tlead": "T_L",
    "tlag": "T_I",
    "tdvis": r"\tau_v",
    "Kvest": "K_{vs}",
    "tdvest": r"\tau_{vs}",
    "Km": "K_m",
    "tdm": r"\tau_m",
    "wc": r"\omega_c",
    "tde": r"\tau_e",
    "tleadlow": "T_K",
    "tlaglow": "T_K'",
    "Kt": "K_t",
    "tlagt": "T_{I,t}",
    "tdt": r"\tau_t",
    "tlook": r"\tau_a",
    "Kf": "K_f",
    "tlagf": "T_{I,f}",
    "tlookf": r"\tau_f",
    "Kn": "K_n",
    "tlagn": "T_{I,n}",
    "tlookn": r"\tau_n",
    "fnm": r"\omega_{nm}",
    "dnm": r"\zeta_{nm}",
    "target_crossover": r"\omega_{c,t}",
    "target_phase_margin": r"\varphi_{m,t}",
    "disturbance_crossover": r"\omega_{c,d}",
    "disturbance_phase_margin": r"\varphi_{m,d}",
    "target_effective_delay": r"\tau_{e,t}",
    "disturbance_effective_delay": r"\tau_{e,d}",
    "remnant_share_u": r"\sigma^2_{u,n}/\sigma^2_u",
    **{f"var_{name}": rf"\sigma^2_{name}" for name in "eux"},
    **{f"rms_{name}": rf"\mathrm{{RMS}}_{name}" for name in "eux"},
    **{
        f"var_{name}_{part}": rf"\sigma^2_{{{name},{index}}}"
        for name in "eux"
        for part, index in (("target", "t"), ("disturbance", "d"), ("remnant", "n"))
    },
}


def symbol(key: str) -> str:
    """The symbol of a quantity between dollar signs; a key without one stays as it is."""
    symbols = []
    for part in re.split(r"([*/+])", key):
        name, index = re.split(r"(\d*)\Z", part, maxsplit=1)[:2]
        sign = SYMBOLS.get(part) or SYMBOLS.get(name)
        if sign is None and part not in ("*", "/", "+"):
            return key
        if sign and index:
            base, underline, below = sign.partition("_")
            sign = f"{base}_{{{below.strip('{}')},{index}}}" if underline else f"{sign}_{index}"
        symbols.append(sign or {"*": r"\,"}.get(part, part))
    return f"${''.join(symbols)}$"


def unit_words(unit: str) -> str:
    """A unit as figures have it."""
    return unit.replace("^2", "²")


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws of a posterior by ensembles of walkers.

    Attributes
    ----------
    keys
        Names of the parameters, the pilot's first.
    positive
        Which of them were sampled by their logarithm, shape (parameters,).
    values
        Parameter values, shape (draws, parameters); ensemble by ensemble, in each step by step,
        in each walker by walker.
    log_density
        Of the posterior on the scale it was sampled on, up to a constant, shape (draws,).
    chains
        Ensembles, steps of each that were kept, and walkers.
    effective
        Effective number of draws of each parameter, shape (parameters,).
    r_hat
        Rank-normalised split R-hat across ensembles, shape (parameters,).
    autocorrelation
        Integrated autocorrelation time [steps], shape (parameters,).
    acceptance
        Share of the proposals that were accepted.
    converged
        Whether there are as many effective draws as asked, and the ensembles agree.
    """

    keys: tuple[str, ...]
    positive: BoolArray
    values: FloatArray
    log_density: FloatArray
    chains: tuple[int, int, int]
    effective: FloatArray
    r_hat: FloatArray
    autocorrelation: FloatArray
    acceptance: float
    converged: bool

    @property
    def centre(self) -> FloatArray:
        """Means on the scale of sampling: geometric ones of positive parameters, (parameters,).

        They keep the product of gain and lead time, which is well known, as the product of
        means does not.
        """
        positive = self.positive
        logs = np.log(np.where(positive, self.values, 1.0))
        return np.asarray(np.where(positive, np.exp(logs.mean(axis=0)), self.values.mean(axis=0)))

    @property
    def covariance(self) -> FloatArray:
        """Posterior covariance, shape (parameters, parameters)."""
        return np.atleast_2d(np.cov(self.values.T, ddof=0))

    @property
    def equal_tailed(self) -> FloatArray:
        """95 % intervals with as much outside on either side, shape (parameters, 2)."""
        return np.quantile(self.values, TAILS, axis=0).T

    def thinned(self, count: int) -> FloatArray:
        """So many draws, evenly from all of them, shape (count, parameters)."""
        every = (np.arange(count) + 0.5) * (len(self.values) / count)
        return np.asarray(self.values[every.astype(int)])

    def to_arviz(self) -> DataTree:
        """The draws for ArviZ: walkers are its chains.

        Raises
        ------
        ImportError
            Without the package arviz-base, which ``pip install 'pilotid[posterior]'`` brings.
        """
        from arviz_base import from_dict

        ensembles, steps, walkers = self.chains
        shaped = self.values.reshape(ensembles, steps, walkers, -1).transpose(0, 2, 1, 3)
        chains = shaped.reshape(ensembles * walkers, steps, -1)
        return from_dict({"posterior": {key: chains[..., i] for i, key in enumerate(self.keys)}})


UNDETERMINED = "not determined"  # in the place of a value and its error


@dataclass(frozen=True)
class Quantity:
    """One number with its standard error and 95 % interval; NaN where the fit failed.

    Attributes
    ----------
    key, unit
        As printed; no unit for a number without dimension.
    value, std_error
        Value and standard error in that unit; of a posterior mean and standard deviation.
    lower, upper
        Ends of the 95 % interval.
    determined
        Whether the recording tells it: False where the interval of a parameter ends at a bound, or
        that of a positive number spans more than a factor of ten; of a loop with its crossover.
    effective, r_hat
        Of a sampled parameter; NaN for functions of several.
    """

    key: str
    unit: str
    value: float
    std_error: float
    lower: float
    upper: float
    determined: bool = True
    effective: float = math.nan
    r_hat: float = math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end of the 95 % interval."""
        return self.lower, self.upper

    def shown(self) -> tuple[str, str]:
        """Value with standard error, and interval, to the digits that the error allows."""
        if not math.isfinite(self.value):
            return "-", ""
        if not self.determined:
            return UNDETERMINED, f"{self.lower:.3g} .. {self.upper:.3g}"
        error = self.std_error
        if not (math.isfinite(error) and error > 0.0):
            return f"{self.value:.4g}", ""
        digits = decimals(error)
        value = f"{self.value:z.{digits}f} ± {error:.{digits}f}"
        return value, f"{self.lower:z.{digits}f} .. {self.upper:z.{digits}f}"

    def to_dict(self) -> dict[str, object]:
        """Plain objects, as JSON has them."""
        return {
            "value": self.value,
            "std_error": self.std_error,
            "interval_95": [self.lower, self.upper],
            "unit": self.unit,
            "determined": self.determined,
        }

    def __str__(self) -> str:
        value, interval = self.shown()
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.key} = {value}{unit}" + (f", 95 % {interval}" if interval else "")


#: Estimates side by side in a table, as many as a usual terminal and a page of paper hold.
ABREAST = 2


def quantity_tables(
    estimates: Sequence[tuple[str, Sequence[Quantity]]], what: str = "parameter"
) -> list[Table]:
    """Tables of quantities, two columns for each estimate, two estimates in each.

    Parameters
    ----------
    estimates
        A name, and quantities with the same keys for all.
    what
        What the rows are.
    """
    tables = []
    for begin in range(0, len(estimates), ABREAST):
        some = estimates[begin : begin + ABREAST]
        titles = [what, "unit"]
        columns: list[list[str]] = [[getattr(q, a) for q in some[0][1]] for a in ("key", "unit")]
        for name, quantities in some:
            titles += [name, "95 % interval"]
            columns += map(list, zip(*(q.shown() for q in quantities), strict=True))
        forms = dict.fromkeys(titles[2:], str)
        tables.append(table([*zip(*columns, strict=True)], "", titles, forms))
    return tables


def frame_of(quantities: Sequence[Quantity]) -> DataFrame:
    """A row for each quantity: key, unit, value, standard error and 95 % interval."""
    from pandas import DataFrame

    columns = ["parameter", "unit", "value", "std_error", "lower_95", "upper_95", "determined"]
    return DataFrame([astuple(q)[: len(columns)] for q in quantities], columns=columns)


def spans_decade(lower: FloatArray | float, upper: FloatArray | float) -> BoolArray:
    """Whether intervals of positive numbers span more than a factor of ten, of their shape."""
    return np.asarray(upper > ESTIMATE.wide * np.asarray(lower))


def sampled(
    key: str,
    unit: str,
    values: FloatArray,
    *,
    effective: float = math.nan,
    r_hat: float = math.nan,
    positive: bool = False,
) -> Quantity:
    """The posterior of a quantity, `positive` or not, from its draws, shape (draws,)."""
    mean, error = float(values.mean()), float(values.std())
    low, high = np.quantile(values, TAILS).tolist()
    known = not (positive and spans_decade(low, high))
    return Quantity(key, unit, mean, error, low, high, known, effective, r_hat)


def normal(key: str, unit: str, value: float, error: float, *, positive: bool = False) -> Quantity:
    """A quantity, `positive` or not, with the interval of a normal distribution, cut at zero."""
    low, high = value - Z95 * error, value + Z95 * error
    known = not (positive and spans_decade(low, high))
    low = max(low, 0.0) if positive else low
    return Quantity(key, unit, value, error, low, high, known)


#: Gain and lead time of the visual channel are correlated at about -0.99; their product, the
#: gain on the error's rate, is known several times more accurately than either.  So are the sum of
#: a delay and a lag, the effective delay, and that of a delay and the time looked ahead.
COMBINED = (
    *("Kvis*tlead", "Kvis1*tlead1", "Kvis2*tlead2"),
    *("tlook+tdvis", "tdvis+tlag"),
)


def combined(
    keys: Sequence[str], values: FloatArray, covariance: FloatArray, draws: Draws | None = None
) -> list[Quantity]:
    """Products and sums of parameters, over draws where there are some, else to first order.

    Parameters
    ----------
    keys
        The parameters' keys.
    values, covariance
        The estimate, shapes (parameters,) and (parameters, parameters).
    draws
        Of the posterior.
    """
    quantities = []
    for key in COMBINED:
        pair, summed = re.split(r"[*+]", key), "+" in key
        if not set(pair) <= set(keys):
            continue
        i, j = map(keys.index, pair)
        if draws is not None:
            first, second = draws.values[:, i], draws.values[:, j]
            both = first + second if summed else first * second
            quantities.append(sampled(key, "s", both, positive=True))
            continue
        value = float(values[i] + values[j] if summed else values[i] * values[j])
        slope = np.zeros(len(keys))
        slope[i], slope[j] = (1.0, 1.0) if summed else (values[j], values[i])
        error = float(np.sqrt(slope @ covariance @ slope))
        quantities.append(normal(key, "s", value, error, positive=True))
    return quantities


class Pair(NamedTuple):
    """Keys of two parameters that cannot be told apart, and the correlation of their errors."""

    first: str
    second: str
    correlation: float

    @property
    def words(self) -> str:
        """What a user must know, in a sentence."""
        sentence = (
            f"{self.first} and {self.second} cannot be told apart (correlation "
            f"{self.correlation:.2f}): as far as one of them is wrong, so is the other"
        )
        both = [key for key in COMBINED if {*re.split(r"[*+]", key)} == {*self[:2]}]
        return f"{sentence}; report {both[0]}" if both and self.correlation < 0.0 else sentence


# ---------------------------------------------------------------------------- parts of an estimate


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
    moved
        By how many of its errors the equations alone would move a parameter at the most; NaN where
        that is not known.
    missed
        How many times their errors the model misses the responses at the forcing frequencies;
        0 where chance may do as much (once in 1,000), and where there are no such frequencies.
    """

    statistic: float
    p_value: float
    against: str
    moved: float = math.nan
    missed: float = 0.0

    @property
    def agrees(self) -> bool:
        """Whether the two agree."""
        return self.p_value >= ESTIMATE.misspecified

    @property
    def sentence(self) -> str:
        """The test in words."""
        p = f"the same model by {self.against} (p = {self.p_value:.2g})"
        if self.missed:
            p += f"; it misses the responses by {self.missed:.1f} times their errors"
        if not self.agrees:
            return f"specification: contradicts {p}"
        if self.p_value < LEVEL:
            return f"specification: differs at the 5 % level, but not clearly, from {p}"
        return f"specification: no significant difference from {p}"

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """What to say of an estimate that disagrees, or of a model that misses the responses."""
        if self.agrees:
            return (misfit_remark(self.missed),) if self.missed else ()
        sure = self.p_value < ESTIMATE.surely_misspecified and not self.moved < ESTIMATE.moved
        grade: Grade = "note" if self.moved < 1.0 else "wrong" if sure else "doubt"
        sentence = (
            f"the estimate contradicts the forcing functions (p = {self.p_value:.1g}): the model "
            f"or the recording is not as the method assumes; fit with {self.against} as well, and "
            "do not use what differs"
        )
        return (Remark("misspecified", sentence, grade),)

    def to_dict(self) -> dict[str, object]:
        """Plain objects."""
        return {**asdict(self), "agrees": self.agrees}


def misfit_remark(missed: float, consequence: str = "") -> Remark:
    """That a model misses responses by so many times their errors, and what follows from that."""
    sentence = (
        f"the model misses the responses at the forcing frequencies by {missed:.1f} times their "
        f"errors: a channel or a lag may be lacking, or the pilot changed{consequence}"
    )
    return Remark("misspecified", sentence, "doubt" if missed > 2.0 else "note")


def score_test(
    score: FloatArray, covariance: FloatArray, least: float, against: str
) -> Specification | None:
    """Hausman's test by scores, which have mean zero if an estimate is right.

    Parameters
    ----------
    score
        Scores that are independent at the true parameters, in units of what they scatter by there,
        shape (directions,).
    covariance
        What is left at the estimate of their covariance, unity, shape (directions, directions).
    least
        Share that is left where the estimate has made use of all: covariances and weights are
        estimates themselves.
    against
        The method whose equations they are of.
    """
    from scipy.special import fdtrc

    shares, along = np.linalg.eigh(covariance)
    scatter = least + np.clip(shares, 0.0, 1.0) ** ESTIMATE.made_use_of
    statistic = float(np.sum((along.T @ score) ** 2 / scatter))
    if not math.isfinite(statistic):
        return None
    # With variances that are estimated the statistic is F's (Hotelling), not chi-squared.
    p_value = float(fdtrc(score.size, ESTIMATE.score_freedom, statistic / score.size))
    return Specification(statistic, p_value, against)
