"""A pilot whose parameters walk at random, as a system for an unscented Kalman filter.

The channel's input is recorded, so that a delay asks for the recorded signal a while ago, between
its samples as well, and needs no state.  Two states are left, those of the neuromuscular system;
its step is exact for constant parameters and an input that is a parabola over the step.  A remnant
of first order is a third.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pilotid.pilot.changing import Polynomial
from pilotid.pilot.factors import Delay, Factor, Neuromuscular
from pilotid.pilot.frozen import frozen
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.scale import Scale
from pilotid.time_domain.muscle import NODES, muscle_step
from pilotid.time_domain.prepare import decimation, derivative_kernel
from pilotid.types import BoolArray, FloatArray, InputError, IntArray

FINEST = 0.005  # seconds between samples between which an input is straight, at most
SHORTEST = 5.0  # seconds that must be left to filter


def unsuited(model: PilotModel) -> str | None:
    """Why the parameters of a model cannot walk here, or None."""
    plain = frozen(model)
    if len(plain.channels) > 1 or plain.channels[0].input != "error":
        return (
            f"model {model.name} is more than one channel on the error, and the filter is of that "
            "alone; use mle, or fit a model such as single or adapting"
        )
    factors = plain.channels[0].dynamics
    muscles, delays, leads = (_of_kind(factors, k) for k in (Neuromuscular, Delay, Polynomial))
    if len(muscles) == 1 and len(delays) == 1 and len(leads) == len(factors) - 2:
        return None
    return (
        "the filter knows gains, leads, one delay and one neuromuscular system, and model "
        f"{model.name} has other dynamics; use mle, or fit a model such as single or adapting"
    )


def _of_kind(factors: tuple[Factor, ...], kind: type) -> list[Factor]:
    return [factor for factor in factors if isinstance(factor, kind)]


@dataclass(frozen=True, eq=False)
class WalkingPilot:
    """The system: parameters in an order of its own, and states of each run.

    The parameters are those of the frozen model: neuromuscular frequency and damping, delay, then
    gains and leads; positive ones as logarithms.  States are the control over its standard
    deviation, its rate, and those of a remnant that is not white.

    Attributes
    ----------
    model
        The frozen model.
    order
        Indices of its parameters in the order of the filter, shape (parameters,).
    dt
        Length of a step [s].
    time
        Times of the steps [s], shape (steps,).
    measured
        The control without its mean over `size`, shape (steps, runs).
    size
        Standard deviation of the control.
    inputs
        The input and its derivatives over `size`, at the nodes of a step that begins at each fine
        sample, shape (fine, nodes, derivatives, runs).
    fine
        Time of the first fine sample, and the interval between them [s].
    remnant
        Step of the remnant's states, the last of which is the remnant, shape (sets, states,
        states); no states for a white one.
    """

    model: PilotModel
    order: IntArray
    dt: float
    time: FloatArray
    measured: FloatArray
    size: float
    inputs: FloatArray
    fine: tuple[float, float]
    remnant: FloatArray = field(default_factory=lambda: np.zeros((1, 0, 0)))

    @cached_property
    def output(self) -> FloatArray:
        """The control, and a remnant that is a state."""
        states = self.remnant.shape[-1]
        return np.array([1.0, 0.0, *[0.0] * (states - 1), *[1.0] * (states > 0)])

    @property
    def runs(self) -> int:
        """Number of runs."""
        return int(self.measured.shape[1])

    def numbers(self, states: int) -> int:
        """Numbers in the covariances of all steps, with so many states of the remnant."""
        size = len(self.order) + self.runs * (2 + states)
        return len(self.time) * size**2

    @cached_property
    def positive(self) -> BoolArray:
        """Which parameters are logarithms, shape (parameters,)."""
        return self.model.positive[self.order]

    @cached_property
    def _scale(self) -> Scale:
        return Scale(self.positive)

    def with_remnant(self, remnant: FloatArray) -> WalkingPilot:
        """The system with another remnant."""
        return replace(self, remnant=remnant)

    def to_walk(self, values: FloatArray) -> FloatArray:
        """Parameters in model order, shape (..., parameters), as the filter has them."""
        return self._scale.enter(values[..., self.order])

    def from_walk(self, walk: FloatArray) -> FloatArray:
        """The opposite of `to_walk`; within the model's bounds."""
        result = np.empty_like(walk)
        result[..., self.order] = self._scale.leave(walk)
        return np.asarray(np.clip(result, self.model.lower, self.model.upper))

    def step(self, k: int | IntArray, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `pilotid.time_domain.unscented.System`; `k` may be one for each set and point."""
        own = np.clip(parameters, *self._limits)
        np.exp(own, out=own, where=self.positive)
        matrix, weights = muscle_step(own[..., 0], own[..., 1], self.dt)
        place = (self.time[k] - self.fine[0] - own[..., 2]) / self.fine[1]
        below = np.clip(place.astype(int), 0, len(self.inputs) - 2)
        part = (place - below)[..., None, None, None]
        signals = self.inputs[below]
        signals = signals + part * (self.inputs[below + 1] - signals)
        coefficients = self._coefficients(own)
        signal = coefficients[0][..., None, None] * signals[..., 0, :]
        for i, c in enumerate(coefficients[1:], 1):
            signal = signal + c[..., None, None] * signals[..., i, :]
        given = signal.swapaxes(-1, -2) @ weights
        states = self.remnant.shape[-1]
        if not states:
            return matrix, given
        wider = np.zeros((*matrix.shape[:-2], 2 + states, 2 + states))
        wider[..., :2, :2] = matrix
        wider[..., 2:, 2:] = self.remnant[:, None]
        more = np.zeros((*given.shape[:-1], 2 + states))
        more[..., :2] = given
        return wider, more

    def left(self, values: FloatArray) -> float:
        """Share of the control's variance that parameters leave, after the first second.

        Parameters
        ----------
        values
            Parameters in model order at each step, shape (steps, parameters), or of all steps,
            shape (parameters,).
        """
        walk = np.broadcast_to(self.to_walk(values), (len(self.time), len(self.order)))
        plain = self.with_remnant(np.zeros((1, 0, 0)))
        state = np.zeros((self.runs, 2))
        found = np.zeros_like(self.measured)
        matrices, given = plain.step(np.arange(len(walk))[:, None], walk[:, None])
        for k in range(len(walk)):
            found[k] = state[:, 0]
            state = state @ matrices[k, 0].T + given[k, 0]
        first = math.ceil(1.0 / self.dt)
        residual = (self.measured - found)[first:]
        return float(np.sum(np.var(residual, axis=0)) / np.sum(np.var(self.measured, axis=0)))

    @cached_property
    def _polynomials(self) -> list[tuple[Polynomial, int, int]]:
        """Gains and leads, each with the places of its parameters."""
        found, first = [], 3
        for factor in _of_kind(self.model.channels[0].dynamics, Polynomial):
            last = first + len(factor.parameters)
            found.append((cast(Polynomial, factor), first, last))
            first = last
        return found

    @cached_property
    def _limits(self) -> tuple[FloatArray, FloatArray]:
        return self.to_walk(self.model.lower), self.to_walk(self.model.upper)

    def _coefficients(self, own: FloatArray) -> list[FloatArray]:
        """Of the input and its derivatives, each of shape (sets, points)."""
        total: list[FloatArray] = [np.ones(1)]
        for factor, first, last in self._polynomials:
            given = factor.coefficients([own[..., i] for i in range(first, last)])
            longer = [np.zeros(1)] * (len(total) + len(given) - 1)
            for i, a in enumerate(total):
                for j, b in enumerate(given):
                    longer[i + j] = longer[i + j] + a * b
            total = longer
        return total


def walking_pilot(
    recording: Recording, model: PilotModel, band: float, *, white: bool
) -> WalkingPilot:
    """Prepare a recording: decimate the control, and refine the input.

    Parameters
    ----------
    recording, model
        What is fitted; see `unsuited`.
    band
        Analysis band [rad/s], which sets the length of a step.
    white
        Whether the remnant is white.
    """
    from scipy.interpolate import CubicSpline

    plain = frozen(model)
    channel = plain.channels[0]
    factors = channel.dynamics
    kinds: tuple[type, ...] = (Neuromuscular, Delay, Polynomial)
    keys = [p.key for kind in kinds for f in _of_kind(factors, kind) for p in f.parameters]
    order = np.array([plain.keys.index(key) for key in keys])
    highest = sum(
        len(f.coefficients([np.array(p.start) for p in f.parameters])) - 1
        for f in factors
        if isinstance(f, Polynomial)
    )
    factor = decimation(recording.dt, band)
    # A mean over a step, of control and input alike, leaves a white remnant white; one of first
    # order stays that if samples are left out.
    smoothing = np.full(factor, 1.0 / factor) if white else np.ones(1)
    kernels = [derivative_kernel(channel.derivative + i, smoothing) for i in range(highest + 1)]
    span = max(kernel.size for kernel in kernels) - 1
    longest = plain.parameters[order[2]].upper
    begin = math.ceil(longest / recording.dt) + 1
    begin += (recording.run_in - span // 2 - begin) % factor  # so that a step begins at 0 s
    places = np.arange(begin, recording.u.shape[1] - span, factor)
    if len(places) * factor * recording.dt < SHORTEST:
        raise InputError(f"{recording.source}: too short for a filter; use a longer recording")
    control = recording.u - recording.u.mean(axis=1, keepdims=True)
    size = float(np.std(control))
    error = recording.input(channel.input)
    error = channel.sign * (error - error.mean(axis=1, keepdims=True)) / size

    def passed(signal: FloatArray, kernel: FloatArray, order: int = 0) -> FloatArray:
        windows = sliding_window_view(signal, kernel.size, axis=1)
        beside = (span + 1 - kernel.size) // 2
        found = windows[:, beside : windows.shape[1] - beside] @ kernel[::-1]
        return np.asarray(found / recording.dt**order)

    measured = passed(control, smoothing)
    known = np.array(
        [passed(error, kernel, channel.derivative + i) for i, kernel in enumerate(kernels)]
    )
    finer = 2 * math.ceil(recording.dt / FINEST / 2.0 - 1e-9)
    coarse = np.arange(known.shape[-1])
    at = np.arange((known.shape[-1] - 1) * finer + 1) / finer
    series = CubicSpline(coarse, known, axis=-1)(at)
    half, middle = factor * finer // 2, 0.5 * span * recording.dt
    ends = series.shape[-1] - 2 * half
    nodes = np.stack([series[..., i * half : i * half + ends] for i in range(NODES)])
    return WalkingPilot(
        model=plain,
        order=order,
        dt=factor * recording.dt,
        time=recording.time[places] + middle,
        measured=np.ascontiguousarray(measured[:, places].T / size),
        size=size,
        inputs=np.ascontiguousarray(nodes.transpose(3, 0, 1, 2)),
        fine=(float(recording.time[0] + middle), recording.dt / finer),
    )
