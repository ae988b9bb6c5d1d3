"""Pilot models: a sum of channels, each a signed product of factors on one input."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import chain, combinations
from types import UnionType
from typing import TYPE_CHECKING

import numpy as np

from pilotid.model.channel import INPUTS, RATE, SHIFTS, STEEP, TIME, AnyFactor, Changing, Channel
from pilotid.model.element import ControlledElement, Rational
from pilotid.model.factors import (
    Evaluated,
    Factor,
    Held,
    Inverse,
    Lag,
    Lead,
    Parameter,
    Response,
)
from pilotid.support.types import BoolArray, ComplexArray, FloatArray, InputError, IntArray

if TYPE_CHECKING:
    import control


#: A factor and the indices of its parameters.
Placed = tuple[Factor, tuple[int, ...]]


@dataclass(frozen=True)
class PilotModel:
    """A parametric model of the human controller, u = sum of channels + remnant.

    Attributes
    ----------
    name, description
        For the command line and reports.
    channels
        The paths that add up to the control.
    overrides
        Parameters whose bounds or start differ from those that the factors give; those that the
        model has not, or that it has fixed, say nothing.

    A structure of one's own takes a few lines::

        PilotModel("lagged", (Channel("visual", "error", 1,
            (Gain("Kvis"), Lag("tlag"), Delay("tdvis"), Neuromuscular())),))
    """

    name: str
    channels: tuple[Channel, ...]
    description: str = ""
    overrides: tuple[Parameter, ...] = ()

    def __post_init__(self) -> None:
        if not self.channels:
            raise ValueError(f"model {self.name} has no channel; give it one at least")
        _ = self.parameters  # refuses what does not fit together, here and not in the first fit

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Free parameters, in order of appearance, neuromuscular ones last."""
        by_key: dict[str, Parameter] = {}
        for parameter in (p for c in self.channels for f in c.factors for p in f.parameters):
            if by_key.setdefault(parameter.key, parameter) != parameter:
                raise ValueError(
                    f"model {self.name}: the two factors that share parameter {parameter.key} "
                    "must give it the same unit, bounds and start"
                )
        by_key |= {p.key: p for p in self.overrides if p.key in by_key}
        return tuple(sorted(by_key.values(), key=lambda p: p.last))

    @property
    def keys(self) -> tuple[str, ...]:
        """Parameter keys in model order."""
        return tuple(p.key for p in self.parameters)

    @cached_property
    def index(self) -> dict[str, int]:
        """The place of each parameter in model order, by its key."""
        return {p.key: i for i, p in enumerate(self.parameters)}

    def _indices(self, parameters: tuple[Parameter, ...]) -> tuple[int, ...]:
        return tuple(self.index[p.key] for p in parameters)

    @cached_property
    def lower(self) -> FloatArray:
        """Lower bounds, shape (parameters,)."""
        return np.array([p.lower for p in self.parameters])

    @cached_property
    def upper(self) -> FloatArray:
        """Upper bounds, shape (parameters,)."""
        return np.array([p.upper for p in self.parameters])

    @cached_property
    def start(self) -> FloatArray:
        """Default initial guess, shape (parameters,)."""
        return np.array([p.start for p in self.parameters])

    @cached_property
    def usual(self) -> FloatArray:
        """Lower and upper ends of the ranges of published values, shape (2, parameters)."""
        return np.array([p.usual for p in self.parameters]).reshape(-1, 2).T

    @cached_property
    def positive(self) -> BoolArray:
        """Which parameters are searched on a logarithmic scale, shape (parameters,)."""
        return np.array([p.positive for p in self.parameters])

    @property
    def delays(self) -> tuple[int, ...]:
        """Indices of the parameters that are time delays."""
        return tuple(i for i, p in enumerate(self.parameters) if p.delay)

    @cached_property
    def linear(self) -> tuple[int, ...]:
        """Indices of the parameters that the response is proportional to."""
        return tuple(i for i, p in enumerate(self.parameters) if p.linear)

    @property
    def fixed_poles(self) -> tuple[float, ...]:
        """Poles that no parameter moves [rad/s]; their free decay is a nuisance term."""
        poles = {p for c in self.channels for f in c.dynamics for p in f.fixed_poles}
        return tuple(sorted(poles))

    def slowest_lag(self, values: FloatArray) -> float:
        """The longest time constant of a lag that parameters move [s], 0 without one.

        Parameters
        ----------
        values
            Parameters in model order, shape (parameters,).
        """
        if self.changes:
            return 0.0
        longest = 0.0
        for factor, indices in {placed for layout in self.layout for placed in layout}:
            lags = [values[i] for i in indices]
            if factor.fixed_poles or factor.seconds(lags) is not None:
                continue
            poles = np.roots(factor.rational([float(value) for value in lags], 1)[1])
            real = poles.real[(poles.imag == 0.0) & (poles.real < 0.0)]
            longest = max(longest, *(-1.0 / real).tolist(), 0.0)
        return longest

    @cached_property
    def ahead(self) -> float:
        """How far the model looks ahead at most [s]."""
        most = {p.key: p.upper for p in self.parameters} | self.held
        return max(sum(most[f.ahead] for f in c.dynamics if f.ahead) for c in self.channels)

    @cached_property
    def extra(self) -> tuple[str, ...]:
        """Signals beside e, x and ft that channels act on: how the loop moves them is unknown."""
        return tuple(dict.fromkeys(c.on for c in self.channels if c.on not in INPUTS.values()))

    @cached_property
    def needs_element(self) -> bool:
        """Whether the model is made for a controlled element and does not know it yet."""
        return Inverse() in [f for c in self.channels for f in c.factors]

    def with_element(self, element: ControlledElement) -> PilotModel:
        """The same model for a controlled element; one that needs none as it is.

        Raises
        ------
        InputError
            If no pilot can invert the element.
        """
        if not self.needs_element:
            return self
        return self._with_factors(lambda f: (Inverse(element) if f == Inverse() else f,))

    def _with_factors(self, change: Callable[[AnyFactor], Sequence[AnyFactor]]) -> PilotModel:
        """The same model with others in place of each factor."""
        channels = (replace(c, factors=(*chain(*map(change, c.factors)),)) for c in self.channels)
        return replace(self, channels=tuple(channels))

    @cached_property
    def changes(self) -> bool:
        """Whether a parameter varies in time; such a model has no frequency response.

        `constant` is the pilot that it is at any one time.
        """
        return any(c.changing is not None for c in self.channels)

    @cached_property
    def is_open(self) -> bool:
        """Whether it acts on the target alone, outside of any loop."""
        return all(channel.on == "ft" for channel in self.channels)

    @cached_property
    def no_loop(self) -> str:
        """Why the loop that it closes has no known responses; empty where these are known."""
        if self.changes:
            return (
                "the pilot changes during the recording, and the controlled element, by which "
                "pilots change, most likely too: it has no one loop"
            )
        if self.is_open:
            return "it acts on the target alone, and closes no loop"
        seen = ", ".join(self.extra)
        return f"it acts on {seen}, and how the loop moves that is not known" if seen else ""

    def require_constant(self) -> None:
        """Refuse a model that varies in time.

        Raises
        ------
        ValueError
            If it does.
        """
        if self.changes:
            raise ValueError(
                f"model {self.name} varies in time, so that it has no frequency response"
            )

    @cached_property
    def layout(self) -> tuple[tuple[Placed, ...], ...]:
        """Per channel, its dynamics, each with the indices of its parameters."""
        return tuple(
            tuple((f, self._indices(f.parameters)) for f in c.dynamics) for c in self.channels
        )

    @cached_property
    def moving(self) -> tuple[Placed, ...]:
        """The dynamics that have parameters, each once, with the indices of these."""
        every = [placed for layout in self.layout for placed in layout if placed[1]]
        return tuple(dict.fromkeys(every))

    def indices_of(self, kinds: type | UnionType) -> list[int]:
        """Indices of the parameters of dynamics of some kinds."""
        return sorted({i for factor, at in self.moving if isinstance(factor, kinds) for i in at})

    @cached_property
    def places(self) -> tuple[tuple[int, ...], ...]:
        """Per channel, which of `moving` it has."""
        return tuple(
            tuple(self.moving.index(placed) for placed in layout if placed[1])
            for layout in self.layout
        )

    @cached_property
    def sharing(self) -> tuple[tuple[int, ...], ...]:
        """For each of `moving`, the channels that have it, as often as they do."""
        return tuple(
            tuple(c for c, places in enumerate(self.places) for each in places if each == place)
            for place in range(len(self.moving))
        )

    def fixed_responses(self, s: ComplexArray) -> list[ComplexArray]:
        """Per channel, the response of its dynamics without parameters, shape (n,) or (1,)."""
        result = []
        for layout in self.layout:
            fixed = [factor.response(s, []) for factor, indices in layout if not indices]
            result.append(np.asarray(reduce(np.multiply, fixed, np.ones(1)), dtype=complex))
        return result

    def evaluated(self, s: ComplexArray, values: FloatArray) -> list[Evaluated]:
        """Responses and log-derivatives of `moving`, of shapes that broadcast to (sets, n).

        Parameters
        ----------
        s
            Laplace variable [rad/s], shape (n,).
        values
            Parameters in model order, shape (parameters,) or (sets, parameters).
        """
        return [
            factor.response_and_slopes(s, [values[..., i, None] for i in indices])
            for factor, indices in self.moving
        ]

    def responses_of(self, evaluated: Sequence[Evaluated]) -> list[Response]:
        """Per channel, the response of all its dynamics that have parameters.

        Parameters
        ----------
        evaluated
            What `evaluated` gave; each response has the shape of those there.
        """
        one = np.ones((1, 1))
        return [
            reduce(np.multiply, [evaluated[place][0] for place in places] or [one])
            for places in self.places
        ]

    def moving_responses(self, s: ComplexArray, values: FloatArray) -> list[Response]:
        """`responses_of` without derivatives, for parameter sets.

        Parameters
        ----------
        s
            Laplace variable i omega [rad/s], shape (n,).
        values
            Parameters in model order, shape (sets, parameters).
        """
        return self.responses_of(
            [
                (factor.response(s, [values[..., i, None] for i in indices]), ())
                for factor, indices in self.moving
            ]
        )

    @cached_property
    def exchangeable(self) -> tuple[tuple[int, int], ...]:
        """Indices of pairs of lags, or of leads, of the same channels, that usually shorter first.

        The response stays the same where the two have one another's values.
        """
        groups: dict[object, list[int]] = {}
        for (factor, indices), channels in zip(self.moving, self.sharing, strict=True):
            if isinstance(factor, Lag | Lead):
                groups.setdefault((type(factor), channels), []).extend(indices)
        shorter_first = (sorted(group, key=lambda i: self.usual[0, i]) for group in groups.values())
        return tuple(pair for group in shorter_first for pair in combinations(group, 2))

    def ordered(self, sets: FloatArray) -> FloatArray:
        """The same pilots, the shorter of `exchangeable` first, where bounds allow for it.

        Parameters
        ----------
        sets
            Parameters in model order, shape (sets, parameters).
        """
        for pair in map(list, self.exchangeable):
            swapped = sets.copy()
            swapped[:, pair] = sets[:, pair[::-1]]
            allowed = np.all((self.lower <= swapped) & (swapped <= self.upper), axis=1)
            longer_first = sets[:, pair[0]] > sets[:, pair[1]]
            sets = np.where((longer_first & allowed)[:, None], swapped, sets)
        return sets

    @cached_property
    def changing_indices(self) -> dict[int, list[int]]:
        """By the index of each channel that varies in time, those of its varying parameters."""
        varying = {c: channel.changing for c, channel in enumerate(self.channels)}
        return {c: [*self._indices(it.parameters)] for c, it in varying.items() if it}

    @cached_property
    def change(self) -> tuple[int, ...]:
        """Indices of middle and rate of the change; empty for a constant pilot."""
        return self._indices((TIME, RATE)) if self.changes else ()

    def changes_elsewhere(self, values: FloatArray) -> list[FloatArray]:
        """Parameters with the change at other times nearby, as a step; none of a constant pilot.

        How well a step at some time suits depends on what the input happened to do then, so that
        the likelihood has one optimum beside the other.

        Parameters
        ----------
        values
            Parameters in model order, shape (parameters,); so are those that come back.
        """
        if not self.changes:
            return []
        (middle, rate), sets = self.change, []
        for shift in SHIFTS:
            moved = values.copy()
            moved[middle] = np.clip(values[middle] + shift, self.lower[middle], self.upper[middle])
            moved[rate] = STEEP
            sets.append(moved)
        return sets

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Parameter values by key as a vector in model order, shape (parameters,)."""
        missing = [key for key in self.keys if key not in values]
        if missing:
            raise InputError(f"model {self.name}: no value for {', '.join(missing)}")
        return np.array([float(values[key]) for key in self.keys])

    def response(self, omega: FloatArray, values: FloatArray) -> ComplexArray:
        """Frequency response of every channel, without its sign.

        Parameters
        ----------
        omega
            Frequencies [rad/s], shape (n,).
        values
            Parameters in model order, shape (parameters,) or (sets, parameters).

        Returns
        -------
        ComplexArray
            Shape (channels, n), or (channels, sets, n).
        """
        self.require_constant()
        s = 1j * np.asarray(omega, dtype=float)
        result = []
        for channel, layout in zip(self.channels, self.layout, strict=True):
            response = np.ones((*values.shape[:-1], s.size), dtype=complex)
            for factor, indices in layout:
                response = response * factor.response(s, [values[..., i, None] for i in indices])
            result.append(response * s**channel.derivative)
        return np.array(result)

    def response_and_jacobian(
        self, omega: FloatArray, values: FloatArray
    ) -> tuple[ComplexArray, ComplexArray]:
        """`response` and its derivative by each parameter.

        Parameters
        ----------
        omega
            Frequencies [rad/s], shape (n,).
        values
            Parameters in model order, shape (parameters,), or parameter sets, shape
            (sets, parameters).

        Returns
        -------
        response, jacobian
            Complex, shape (channels, n) and (channels, parameters, n); for parameter sets
            (sets, ...) each.
        """
        rows = self.at(omega)(values)
        return rows[..., -1, :], rows[..., :-1, :]

    def at(self, omega: FloatArray) -> Callable[[FloatArray], ComplexArray]:
        """What evaluates the model at fixed frequencies, again and again.

        Parameters
        ----------
        omega
            Frequencies [rad/s], shape (n,).

        Returns
        -------
        Callable
            From parameters in model order, shape (parameters,) or (sets, parameters), to the
            derivatives of `response` by each and, below them, the response: shape (channels,
            parameters + 1, n), or (sets, ...).
        """
        self.require_constant()
        s = 1j * np.asarray(omega, dtype=float)
        every = [
            response * s**channel.derivative
            for channel, response in zip(self.channels, self.fixed_responses(s), strict=True)
        ]

        def rows(values: FloatArray) -> ComplexArray:
            evaluated = self.evaluated(s, values)
            shape = (len(every), values.shape[-1] + 1, s.size)
            result = np.zeros((*values.shape[:-1], *shape), dtype=complex)
            for c, (places, fixed) in enumerate(zip(self.places, every, strict=True)):
                response = reduce(np.multiply, [evaluated[place][0] for place in places], fixed)
                result[..., c, -1, :] = response
                for place in places:
                    indices, slopes = self.moving[place][1], evaluated[place][1]
                    for index, slope in zip(indices, slopes, strict=True):
                        result[..., c, index, :] += slope * response
            return result

        return rows

    def polynomials(self, values: FloatArray, pade_order: int = 5) -> list[Rational]:
        """Each channel's polynomials, delays as Pade approximants.

        Without sign and differentiators: the input is the derivative that the channel acts on.

        Parameters
        ----------
        values
            Parameters in model order, shape (parameters,).
        pade_order
            Order of numerator and denominator in place of a delay.
        """
        self.require_constant()
        result: list[Rational] = []
        for layout in self.layout:
            top, bottom = np.ones(1), np.ones(1)
            for factor, indices in layout:
                above, below = factor.rational([float(values[i]) for i in indices], pade_order)
                top, bottom = np.convolve(top, above), np.convolve(bottom, below)
            result.append((top.tolist(), bottom.tolist()))
        return result

    def rational(self, values: FloatArray, pade_order: int = 5) -> list[control.TransferFunction]:
        """Each channel as a python-control transfer function, without its sign.

        Parameters
        ----------
        values
            Parameters in model order, shape (parameters,).
        pade_order
            See `polynomials`.
        """
        import control

        return [
            control.TransferFunction([*top, *[0.0] * channel.derivative], bottom)
            for channel, (top, bottom) in zip(
                self.channels, self.polynomials(values, pade_order), strict=True
            )
        ]

    @cached_property
    def held(self) -> dict[str, float]:
        """Values of the parameters that are fixed, by their keys."""
        return {p.key: value for p, value in self._held}

    @property
    def _held(self) -> list[tuple[Parameter, float]]:
        factors = [f for c in self.channels for f in c.factors if isinstance(f, Held)]
        return [pair for factor in factors for pair in factor.held]

    @property
    def held_words(self) -> list[str]:
        """These in words, as tables say them: a line, or none."""
        words = (f"{p.key} = {value:g} {p.unit}".rstrip() for p, value in self._held)
        return [f"held, not estimated: {', '.join(dict.fromkeys(words))}"] if self.held else []

    def with_fixed(self, **values: float) -> PilotModel:
        """The same model with parameters held at values, by any method, without an interval.

        Raises
        ------
        InputError
            For a parameter that the model lacks, one that varies in time, or a value outside its
            bounds.
        """
        self._require(values)
        for key, value in values.items():
            known = self.parameters[self.index[key]]
            if not known.lower <= value <= known.upper:
                bounds = f"{known.lower:g} to {known.upper:g} {known.unit}".rstrip()
                raise InputError(f"{key} cannot be held at {value:g}; give a number from {bounds}")

        def fixed(factor: AnyFactor) -> Sequence[AnyFactor]:
            constants = tuple(
                (p, float(values[p.key])) for p in factor.parameters if p.key in values
            )
            if constants and isinstance(factor, Changing):
                key = constants[0][0].key
                raise InputError(f"{key} varies in time, and cannot be held at a value")
            if isinstance(factor, Held):
                return (Held(factor.factor, factor.held + constants),)
            return (Held(factor, constants) if constants else factor,)  # type: ignore[arg-type]

        return self._with_factors(fixed)

    def with_bounds(self, **bounds: tuple[float, float]) -> PilotModel:
        """The same model with other bounds of the search, by key.

        Raises
        ------
        InputError
            For a parameter that the model lacks, or bounds that are none.
        """
        self._require(bounds)
        changed = []
        for key, (lower, upper) in bounds.items():
            known = self.parameters[self.index[key]]
            if not (0.0 if known.positive or known.delay else -np.inf) <= lower < upper < np.inf:
                raise InputError(f"{key}: {lower:g} .. {upper:g} are no bounds; give LOWER..UPPER")
            lower = max(lower, 1e-6 * upper) if known.positive else lower
            inside = np.clip(known.usual, lower, upper)
            usual = tuple(inside) if inside[0] < inside[1] else (lower, upper)
            middle = (lower * upper) ** 0.5 if lower > 0.0 else 0.5 * (lower + upper)
            start = known.start if lower < known.start < upper else middle
            changed.append(replace(known, lower=lower, upper=upper, start=start, usual=usual))
        return self._with(changed)

    def _with(self, parameters: Iterable[Parameter]) -> PilotModel:
        overrides = {p.key: p for p in (*self.overrides, *parameters)}
        return replace(self, overrides=tuple(overrides.values()))

    def _require(self, keys: Iterable[str]) -> None:
        if unknown := [key for key in keys if key not in self.index]:
            raise InputError(
                f"model {self.name} has no parameter {', '.join(unknown)}: "
                f"choose from {', '.join(self.keys)}"
            )

    def with_start(self, values: Mapping[str, float]) -> PilotModel:
        """The same model with other initial guesses for the parameters named."""
        try:
            values = {key: float(value) for key, value in values.items()}
        except (AttributeError, TypeError, ValueError):
            raise InputError(f"starts are numbers by name: {{'{self.keys[0]}': 0.5}}") from None
        self._require(values)
        changed = [p for p in self.parameters if p.key in values]
        for p in changed:
            if not p.lower < values[p.key] < p.upper:
                raise InputError(
                    f"the start {p.key}={values[p.key]:g} lies outside the bounds of model "
                    f"{self.name}, {p.lower:g} to {p.upper:g}"
                )
        return self._with(replace(p, start=float(values[p.key])) for p in changed)

    @cached_property
    def constant(self) -> PilotModel:
        """The model with what varies in time taken for constant; a constant one as it is."""
        if not self.changes:
            return self
        return self._with_factors(lambda f: f.factors if isinstance(f, Changing) else (f,))

    @property
    def ends(self) -> tuple[IntArray, IntArray]:
        """Indices of the parameters at the beginning and at the end, shape (constant model's,)."""
        before, after = dict(self.index), dict(self.index)
        for changing in filter(None, (c.changing for c in self.channels)):
            for p in changing.changed:
                first, last = changing.ends(p.key)
                before[p.key], after[p.key] = self.index[first], self.index[last]
        keys = self.constant.keys
        return np.array([before[key] for key in keys]), np.array([after[key] for key in keys])
