"""Channels of a pilot, and gains and leads that pass from one value to another along a sigmoid.

What varies acts on the channel's input before delay and neuromuscular system, which are given a
sum of the input and its derivatives, each times a function of time: K(t) (1 + T(t) s) e becomes
K(t) e + K(t) T(t) de/dt.  So variation in time is a property of the model, and any method that
predicts in the time domain can take it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np

from pilotid.model.factors import Factor, Gain, Lead, Parameter
from pilotid.support.types import SIGNAL_NAME, FloatArray, InputError, is_signal_name

#: Rate [1/s] from which on a change is a step: it takes less than half a second.
STEEP = 10.0
#: By how much a search moves a step in time [s].
SHIFTS = (-4.0, -2.8, -2.0, -1.4, -0.8, -0.4, 0.0, 0.4, 0.8, 1.4, 2.0, 2.8, 4.0)
#: Middle [s] and rate [1/s] of the change.
TIME = Parameter("tmid", "s", 0.0, 120.0, 30.0, (10.0, 70.0), positive=False)
RATE = Parameter("rate", "1/s", 0.05, 120.0, 2.0, (0.1, 50.0))


@dataclass(frozen=True)
class Changing:
    """A gain and a lead of a channel that pass from one value to another along a sigmoid.

    Every parameter P becomes two, P1 and P2, and is

        P(t) = P1 + (P2 - P1)/(1 + exp(-rate (t - tmid)))

    (Zaal, JGCD 39(5) 2016).  The time t runs from the start of the measurement window; three
    quarters of the change take 4/rate.

    Attributes
    ----------
    factors
        A `Gain`, a `Lead`, or a gain and then a lead.
    """

    factors: tuple[Gain | Lead, ...]

    def __post_init__(self) -> None:
        if [type(f) for f in self.factors] not in ([Gain], [Lead], [Gain, Lead]):
            raise ValueError(
                "what varies in time is a Gain, a Lead, or a Gain and then a Lead; give all else "
                "to the channel"
            )

    @property
    def changed(self) -> tuple[Parameter, ...]:
        """The parameters of the factors, which vary."""
        return tuple(p for factor in self.factors for p in factor.parameters)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Each parameter before and after, then the middle and the rate of the change."""
        both = [replace(p, key=key) for p in self.changed for key in self.ends(p.key)]
        return (*both, TIME, RATE)

    @property
    def order(self) -> int:
        """Highest derivative of the channel's input that is used."""
        return int(isinstance(self.factors[-1], Lead))

    def ends(self, key: str) -> tuple[str, str]:
        """Keys of what a parameter of the factors is before and after the change."""
        return f"{key}1", f"{key}2"

    def weights(self, time: FloatArray, values: FloatArray) -> list[FloatArray]:
        """What multiplies the channel's input and its derivatives, each of shape (..., n).

        Parameters
        ----------
        time
            Times from the start of the measurement window [s], shape (n,).
        values
            Sets of the change's parameters, shape (..., parameters).
        """
        gain, lead = self._gain_and_lead(values, share_passed(time, values))
        return [gain, gain * lead][: 1 + self.order]

    def modulated(
        self, signals: FloatArray, time: FloatArray, values: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """The modulated input, and its derivative by each parameter.

        Parameters
        ----------
        signals
            The channel's input and its derivatives up to `order`, shape (order + 1, runs, n).
        time
            See `weights`.
        values
            Sets of the change's parameters, shape (sets, parameters).

        Returns
        -------
        Arrays of shape (sets, runs, n) and (sets, parameters, runs, n).
        """
        share = share_passed(time, values)
        gain, lead = self._gain_and_lead(values, share)
        led = _weighted([np.ones(1), lead][: 1 + self.order], signals)
        by_own = [led] if isinstance(self.factors[0], Gain) else []
        if self.order:
            by_own.append(_weighted([gain], signals[1:]))
        slopes = np.empty((len(values), values.shape[1], *signals.shape[1:]))
        for i, by in enumerate(by_own):
            np.multiply(by, (1.0 - share)[:, None], out=slopes[:, 2 * i])
            np.multiply(by, share[:, None], out=slopes[:, 2 * i + 1])
        steep = share * (1.0 - share)
        middle, rate = values[:, -2, None], values[:, -1, None]
        step = values[:, 1:-2:2] - values[:, :-2:2]
        for place, slope in ((-2, -rate * steep), (-1, (time - middle) * steep)):
            parts = [by * (step[:, i, None] * slope)[:, None] for i, by in enumerate(by_own)]
            slopes[:, place] = reduce(np.add, parts)
        return gain[..., None, :] * led, slopes

    def _gain_and_lead(
        self, values: FloatArray, share: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Both where so much of the change has passed, shape (..., n); one that is constant is 1.

        Without a lead nothing is multiplied with it.
        """
        before, after = values[..., :-2:2, None], values[..., 1:-2:2, None]
        at = np.moveaxis(before + (after - before) * share[..., None, :], -2, 0)
        gain = at[0] if isinstance(self.factors[0], Gain) else np.ones(1)
        return gain, at[-1]


AnyFactor = Factor | Changing

#: Words for the signals of the loop that a channel acts on.
INPUTS = {"error": "e", "output": "x", "target": "ft"}


@dataclass(frozen=True)
class Channel:
    """One path of the pilot, from an input signal to the control.

    Attributes
    ----------
    name
        As in tables and files, for example ``visual``.
    on
        The signal that it acts on: ``e``, ``x``, ``ft`` (or ``error``, ``output``, ``target``), or
        the name of another recorded signal, as in `Recording.extra`.
    sign
        +1 or -1: motion channels act against the output.
    factors
        Their product is the channel's response (without the sign); what varies in time acts first.
    """

    name: str
    on: str
    sign: int
    factors: tuple[AnyFactor, ...]

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[\w .+-]{1,40}", self.name):
            raise ValueError(
                f"channel {self.name!r}: the name must be letters, digits, blanks and . + -, 40 at "
                "most"
            )
        object.__setattr__(self, "on", INPUTS.get(self.on, self.on))
        if self.on in ("t", "u") or not is_signal_name(self.on):
            raise ValueError(
                f"channel {self.name}: cannot act on {self.on!r}; name a signal such as e, x, ft "
                f"or x2: {SIGNAL_NAME}"
            )
        if self.sign not in (1, -1):
            raise ValueError(
                f"channel {self.name}: the sign must be 1 or -1, not {self.sign!r}; "
                "its size belongs to a gain"
            )
        known = all(isinstance(f, AnyFactor) for f in self.factors)
        if not (self.factors and known) or sum(isinstance(f, Changing) for f in self.factors) > 1:
            raise InputError(
                f"channel {self.name}: give it factors, which derive from "
                "pilotid.model.factors.Factor, and put all that vary in time into one Changing"
            )

    @cached_property
    def derivative(self) -> int:
        """Order of the input's derivative that the channel acts on."""
        return sum(f.derivative for f in self.factors if isinstance(f, Factor))

    @cached_property
    def dynamics(self) -> tuple[Factor, ...]:
        """The factors apart from the differentiators and from what varies in time."""
        return tuple(f for f in self.factors if isinstance(f, Factor) and not f.derivative)

    @cached_property
    def changing(self) -> Changing | None:
        """The factor that varies in time and acts on the input first; None for none."""
        return next((f for f in self.factors if isinstance(f, Changing)), None)


def share_passed(time: FloatArray, values: FloatArray) -> FloatArray:
    """How much of the change has passed, 0 to 1, shape (..., n)."""
    middle, rate = values[..., -2, None], values[..., -1, None]
    return np.asarray(0.5 + 0.5 * np.tanh(0.5 * rate * (time - middle)))


def _weighted(weights: list[FloatArray], signals: FloatArray) -> FloatArray:
    """Sum of weights (sets, n) times as many signals (runs, n), shape (sets, runs, n)."""
    parts = [weight[..., None, :] * signal for weight, signal in zip(weights, signals, strict=True)]
    return np.asarray(reduce(np.add, parts))
