"""Prior distributions of pilot and remnant parameters.

All are proper and weak: the range of published values holds four fifths of each, and they
hardly bend a likelihood that knows anything.  A gain enters the prediction linearly, so that
its likelihood is a normal distribution; its prior is flat up to the largest published
value, and falls off so slowly beyond that another unit of the control does no harm.
docs/posterior.md has the table.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pilotid.pilot.factors import Parameter
from pilotid.pilot.model import PilotModel
from pilotid.support.types import FloatArray, InputError
from pilotid.time_domain.remnant_models import NoiseModel

#: Standard deviations from the middle of a normal distribution that hold four fifths of it.
FOUR_FIFTHS = 1.2815515655446004


class Prior(Protocol):
    """What is asked of a prior; a frozen distribution of scipy.stats has it."""

    def logpdf(self, x: FloatArray) -> FloatArray:
        """Logarithm of the density."""
        ...


@dataclass(frozen=True)
class LogNormal:
    """A positive parameter whose logarithm is normal.

    Attributes
    ----------
    median
        In the parameter's unit.
    spread
        Standard deviation of the natural logarithm.
    """

    median: float
    spread: float

    def logpdf(self, x: FloatArray) -> FloatArray:
        offset = np.log(x / self.median) / self.spread
        constant = math.log(self.spread * math.sqrt(2.0 * math.pi))
        return np.asarray(-0.5 * offset * offset - np.log(x) - constant)

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Random values, shape (count,)."""
        return self.median * np.exp(self.spread * rng.standard_normal(count))


@dataclass(frozen=True)
class Normal:
    """A parameter that may be zero, such as a delay.

    Attributes
    ----------
    mean, spread
        Mean and standard deviation, in the parameter's unit.
    """

    mean: float
    spread: float

    def logpdf(self, x: FloatArray) -> FloatArray:
        offset = (x - self.mean) / self.spread
        constant = math.log(self.spread * math.sqrt(2.0 * math.pi))
        return np.asarray(-0.5 * offset * offset - constant)

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Random values, shape (count,)."""
        return self.mean + self.spread * rng.standard_normal(count)


@dataclass(frozen=True)
class HalfCauchy:
    """A gain: flat far below the scale, proportional to its inverse square far above.

    Attributes
    ----------
    scale
        The median, in the parameter's unit.
    """

    scale: float

    def logpdf(self, x: FloatArray) -> FloatArray:
        constant = math.log(2.0 / (math.pi * self.scale))
        return np.asarray(constant - np.log1p((x / self.scale) ** 2))

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Random values, shape (count,)."""
        return np.asarray(self.scale * np.tan(0.5 * np.pi * rng.uniform(size=count)))


#: Priors that replace the defaults, by the key of their parameter.
Replacements = Sequence[tuple[str, Prior]]


def default_prior(parameter: Parameter) -> Prior:
    """The prior of a pilot parameter: what is known of it before the recording."""
    low, high = parameter.usual
    if parameter.linear and parameter.positive:
        return HalfCauchy(high)
    if parameter.positive:
        return LogNormal(math.sqrt(low * high), 0.5 * math.log(high / low) / FOUR_FIFTHS)
    return Normal(0.5 * (low + high), 0.5 * (high - low) / FOUR_FIFTHS)


#: Four fifths of the remnants' break frequencies lie in 1 to 30 rad/s, of the dampings in
#: 0.2 to 1.5.
REMNANT: dict[str, Prior] = {
    "frequency": LogNormal(5.5, 1.33),
    "damping": LogNormal(0.55, 0.79),
    "corner": LogNormal(0.7, 1.0),
}


def priors_of(
    model: PilotModel, noise: NoiseModel, replaced: Replacements = ()
) -> tuple[Prior, ...]:
    """The priors of a model's parameters and, after them, of the remnant's where they are sampled.

    Parameters
    ----------
    model
        The pilot model.
    noise
        The remnant's model; autoregressive coefficients have none, see
        `pilotid.posterior.likelihood`.
    replaced
        Priors in the place of the defaults.

    Raises
    ------
    InputError
        If one is given for a parameter that neither the model nor any remnant has.
    """
    given = dict(replaced)
    unknown = [key for key in given if key not in (*model.keys, *REMNANT)]
    if unknown:
        raise InputError(
            f"a prior is given for {', '.join(unknown)}, which model {model.name} lacks: "
            f"choose from {', '.join((*model.keys, *REMNANT))}"
        )
    pilot = [given.get(p.key) or default_prior(p) for p in model.parameters]
    keys = () if noise.regressive else noise.keys
    return (*pilot, *(given.get(key) or REMNANT[key] for key in keys))
