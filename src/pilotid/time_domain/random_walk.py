"""Pilots whose parameters are random walks: the state space of an unscented Kalman filter.

The channel's input is recorded, so that a delay asks for the recorded signal a while ago, between
its samples as well, and needs no state.  Two states are left, those of the neuromuscular system;
its step is exact for constant parameters and an input that is a parabola over the step.  Two
equal lags behind white noise, of which one or both count, are the remnant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pilotid.pilot.factors import Delay, Factor, Neuromuscular, Polynomial
from pilotid.pilot.model import PilotModel
from pilotid.pilot.timevarying import product_of
from pilotid.recordings.recording import Recording
from pilotid.solve.least_squares import LogTransform
from pilotid.time_domain.prepare import decimation
from pilotid.time_domain.unscented import Levels, block_diagonal
from pilotid.types import BoolArray, FloatArray, InputError, IntArray

NODES = 3  # of the parabola that the input is, over a step
#: What each power of time within a step counts for each node.
PARABOLA = np.array([[1.0, -3.0, 2.0], [0.0, 4.0, -4.0], [0.0, -1.0, 2.0]])


def muscle_step(
    frequency: FloatArray, damping: FloatArray, dt: float
) -> tuple[FloatArray, FloatArray]:
    """Step of f^2/(s^2 + 2 d f s + f^2) with states output and rate.

    Returns
    -------
    Its matrix, shape (..., 2, 2), and what the input at start, middle and end of the step adds,
    shape (..., nodes, 2).
    """
    square, loss = frequency * frequency, damping * frequency
    turn = dt * dt * square * (damping * damping - 1.0)
    root, over, decay = np.sqrt(np.abs(turn)) + 1e-12, turn > 0.0, np.exp(-loss * dt)
    even = decay * np.where(over, np.cosh(root), np.cos(root))
    odd = decay * np.where(over, np.sinh(root), np.sin(root)) * (dt / root)
    matrix, moments = np.empty((*root.shape, 2, 2)), np.empty((*root.shape, NODES, 2))
    matrix[..., 0, 0], matrix[..., 0, 1] = even + loss * odd, odd
    matrix[..., 1, 0], matrix[..., 1, 1] = -square * odd, even - loss * odd
    # Integrals of e^(A (dt - t)) B (t/dt)^j, each from the one before.
    position, rate = 1.0 - matrix[..., 0, 0], square * odd
    for j in range(NODES):
        if j:
            before, rest = j / dt * position, j / dt * rate - square
            position, rate = -2.0 * damping / frequency * before - rest / square, before
        moments[..., j, 0], moments[..., j, 1] = position, rate
    return matrix, PARABOLA @ moments


F = TypeVar("F", bound=Factor)
KINDS: tuple[type[Factor], ...] = (Neuromuscular, Delay, Polynomial)
FINEST = 0.005  # seconds between samples between which an input is straight, at most
SHORTEST = 5.0  # seconds that must be left to filter
#: Standard deviations at the start: of logarithms, and of a delay in seconds.
APART, APART_DELAY = 0.5, 0.05
#: Noise of the neuromuscular system over a step, as share of the control: it keeps covariances
#: positive.
MOTOR = 1e-3
#: White part of a remnant with a lag, and the other of a white one, as share of its standard
#: deviation.
WHITE = 0.03


def unsuited(model: PilotModel) -> str | None:
    """Why the parameters of a model cannot walk here, or None."""
    channel, *others = model.constant.channels
    counts = [len(_of_kind(channel.dynamics, kind)) for kind in KINDS]
    known = counts[:2] == [1, 1] and sum(counts) == len(channel.dynamics)
    if known and not others and channel.on == "e":
        return None
    return (
        "the filter knows one channel on the error with gains, leads, one delay and one "
        f"neuromuscular system, and model {model.name} has others; use mle, or fit a model such as "
        "single or adapting"
    )


def _of_kind(factors: tuple[Factor, ...], kind: type[F]) -> list[F]:
    return [factor for factor in factors if isinstance(factor, kind)]


@dataclass(frozen=True, eq=False)
class WalkingPilot:
    """The system: parameters in an order of its own, and states of each run.

    The parameters are those of the constant model: neuromuscular frequency and damping, delay, then
    gains and leads; positive ones as logarithms.  States are the control over its standard
    deviation, its rate, and three of the remnant, the last of which is its mean over the step.

    Attributes
    ----------
    model
        The constant model.
    dt
        Length of a step [s].
    time
        Times of the steps [s], shape (steps,).
    measured
        The control without its mean over its standard deviation, shape (steps, runs).
    inputs
        The input and its derivatives over the same, at the nodes of a step that begins at each
        fine sample, shape (fine, nodes, derivatives, runs).
    fine
        Time of the first fine sample, and the interval between them [s].
    lags
        Step of the remnant's states, shape (sets, 3, 3).
    """

    model: PilotModel
    dt: float
    time: FloatArray
    measured: FloatArray
    inputs: FloatArray
    fine: tuple[float, float]
    lags: FloatArray
    output = np.array([1.0, 0.0, 0.0, 0.0, 1.0])

    @cached_property
    def order(self) -> IntArray:
        """Indices of the model's parameters in the order of the filter, shape (parameters,)."""
        factors = self.model.channels[0].dynamics
        keys = [p.key for kind in KINDS for f in _of_kind(factors, kind) for p in f.parameters]
        return np.array([self.model.keys.index(key) for key in keys])

    @cached_property
    def positive(self) -> BoolArray:
        """Which parameters are logarithms, shape (parameters,)."""
        return self.model.positive[self.order]

    def to_walk(self, values: FloatArray) -> FloatArray:
        """Parameters in model order, shape (..., parameters), as the filter has them."""
        return LogTransform(self.positive).enter(values[..., self.order])

    def from_walk(self, walk: FloatArray) -> FloatArray:
        """The opposite of `to_walk`; within the model's bounds."""
        result = np.empty_like(walk)
        result[..., self.order] = LogTransform(self.positive).leave(walk)
        return np.asarray(np.clip(result, self.model.lower, self.model.upper))

    def step(self, k: int | IntArray, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `pilotid.time_domain.unscented.System`; `k` may be one for each set and point."""
        own = np.clip(parameters, *self._limits)
        np.exp(own, out=own, where=self.positive)
        matrix = np.zeros((*own.shape[:2], 5, 5))
        matrix[..., :2, :2], weights = muscle_step(own[..., 0], own[..., 1], self.dt)
        matrix[..., 2:, 2:] = self.lags[:, None]
        place = (self.time[k] - self.fine[0] - own[..., 2]) / self.fine[1]
        below = np.clip(place.astype(int), 0, len(self.inputs) - 2)
        part = (place - below)[..., None, None, None]
        known = (1.0 - part) * self.inputs[below] + part * self.inputs[below + 1]
        polynomials = (f.coefficients([own[..., i] for i in at]) for f, at in self._polynomials)
        product = np.stack(np.broadcast_arrays(*product_of(polynomials)), axis=-1)
        given = np.zeros((*own.shape[:2], self.measured.shape[1], 5))
        given[..., :2] = np.einsum("spndr,spd->sprn", known, product) @ weights
        return matrix, given

    def left(self, values: FloatArray) -> float:
        """Share of the control's variance that parameters leave, after the first second.

        Parameters
        ----------
        values
            Parameters in model order at each step, shape (steps, parameters), or of all steps,
            shape (parameters,).
        """
        walk = np.broadcast_to(self.to_walk(values), (len(self.time), len(self.order)))
        found = np.zeros((*self.measured.shape, 5))
        matrices, given = self.step(np.arange(len(walk))[:, None], walk[:, None])
        for k in range(len(walk) - 1):
            found[k + 1] = found[k] @ matrices[k, 0].T + given[k, 0]
        first = math.ceil(1.0 / self.dt)
        residual = (self.measured - found[..., 0])[first:]
        return float(np.sum(np.var(residual, axis=0)) / np.sum(np.var(self.measured, axis=0)))

    @cached_property
    def _polynomials(self) -> list[tuple[Polynomial, range]]:
        """Gains and leads, each with the places of its parameters."""
        found, first = [], 3
        for factor in _of_kind(self.model.channels[0].dynamics, Polynomial):
            found.append((factor, range(first, first + len(factor.parameters))))
            first += len(factor.parameters)
        return found

    @cached_property
    def _limits(self) -> tuple[FloatArray, FloatArray]:
        return self.to_walk(self.model.lower), self.to_walk(self.model.upper)

    def with_levels(
        self, start: FloatArray, groups: FloatArray, levels: FloatArray, orders: IntArray
    ) -> tuple[WalkingPilot, Levels]:
        """The system and its noise.

        Parameters
        ----------
        start
            Parameters at which the filter starts, in model order, shape (parameters,).
        groups
            Per level of the walks how far each parameter goes with it, shape (walks, parameters).
        levels
            Logarithms of the levels of walks, of the remnant's standard deviation over that of
            the control, and of its lag, shape (sets, walks + 2).
        orders
            Number of lags of the remnant in each set, 0 for a white one, shape (sets,).
        """
        runs = self.measured.shape[1]
        walks = np.exp(2.0 * levels[:, :-2]) @ groups**2 * self.dt
        variance = np.exp(2.0 * levels[:, -2])
        step, noise, first = _remnant(self.dt, np.exp(levels[:, -1]), orders)
        seen = (variance * np.where(orders, 1.0, WHITE**2))[:, None, None]
        error = variance * np.where(orders, WHITE**2, 1.0)
        mean = self.to_walk(start)
        muscle = np.tile(np.diag([1.0, np.exp(2.0 * mean[0])]), (len(levels), 1, 1))
        apart = np.tile(
            np.diag(np.where(self.positive, APART, APART_DELAY) ** 2), (len(levels), 1, 1)
        )
        walk = walks[:, :, None] * np.eye(len(mean))
        return replace(self, lags=step), Levels(
            noise=block_diagonal(walk, *[MOTOR**2 * muscle, seen * noise] * runs),
            error=error,
            mean=np.tile(np.concatenate([mean, np.zeros(5 * runs)]), (len(levels), 1)),
            covariance=block_diagonal(apart, *[muscle, seen * first] * runs),
        )


def _remnant(
    dt: float, lag: FloatArray, orders: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """White noise through one or two equal lags: step, its noise, and covariance at rest.

    Parameters
    ----------
    dt
        Length of a step [s].
    lag
        Shape (sets,) [s].
    orders
        Number of lags, shape (sets,); of one, the first state is another noise beside it.

    Returns
    -------
    Three arrays (sets, 3, 3); states are both lags, the last of variance 1, and its mean over
    the step that ends.
    """
    two = (orders == 2)[:, None]

    def moved(time: float) -> FloatArray:
        """States after a time, from either lag alone at 1, shape (2, sets, 3)."""
        x = time / lag
        left = np.exp(-x)
        columns = [
            [left, x * left, lag / dt * (1.0 - (1.0 + x) * left)],
            [np.zeros_like(x), left, lag / dt * (1.0 - left)],
        ]
        return np.asarray(columns).swapaxes(1, 2)

    step = np.zeros((len(lag), 3, 3))
    first, second = moved(dt)
    step[:, :, 0], step[:, :, 1] = np.where(two, first, 0.0), second
    noise = np.zeros_like(step)
    for node, weight in zip(*np.polynomial.legendre.leggauss(8), strict=True):
        first, second = moved(0.5 * dt * (1.0 + node))
        pulse = np.where(two, first * np.sqrt(2.0), second)
        noise += weight * (dt / lag)[:, None, None] * pulse[:, :, None] * pulse[:, None, :]
    noise[:, 0, 0] += orders != 2
    still = np.zeros_like(step)
    still[:, :2, :2] = np.where(two[..., None], [[2.0, 1.0], [1.0, 1.0]], np.eye(2))
    return step, noise, step @ still @ step.swapaxes(1, 2) + noise


def walking_pilot(recording: Recording, model: PilotModel, band: float) -> WalkingPilot:
    """Prepare a recording: means of the control over steps, and the input between samples.

    Parameters
    ----------
    recording, model
        What is fitted; see `unsuited`.
    band
        Analysis band [rad/s], which sets the length of a step.
    """
    from scipy.interpolate import make_interp_spline

    plain = model.constant
    channel = plain.channels[0]
    leads = _of_kind(channel.dynamics, Polynomial)
    highest = sum(len(f.coefficients([np.array(p.start) for p in f.parameters])) - 1 for f in leads)
    (delay,) = (delay.parameters[0] for delay in _of_kind(channel.dynamics, Delay))
    dt, factor = recording.dt, decimation(recording.dt, band)
    size = float(np.std(recording.u - recording.u.mean(axis=1, keepdims=True)))

    def averaged(signal: FloatArray) -> FloatArray:
        """Over a step, which loses less of the remnant than a sample for each step."""
        signal = (signal - signal.mean(axis=1, keepdims=True)) / size
        return np.asarray(sliding_window_view(signal, factor, axis=1).mean(axis=-1))

    control, error = averaged(recording.u), averaged(channel.sign * recording.input(channel.on))
    places = np.arange(math.ceil(delay.upper / dt) + 1, control.shape[1], factor)
    if len(places) * factor * dt < SHORTEST:
        raise InputError(f"{recording.source}: too short for a filter; use a longer recording")
    time = recording.time[0] + (np.arange(control.shape[1]) + 0.5 * (factor - 1)) * dt
    finer = 2 * math.ceil(dt / FINEST / 2.0 - 1e-9)
    fine = time[0] + np.arange((time.size - 1) * finer + 1) * (dt / finer)
    spline = make_interp_spline(time, error, k=5, axis=1)
    series = np.array([spline(fine, channel.derivative + i) for i in range(highest + 1)])
    half = factor * finer // 2
    nodes = sliding_window_view(series, 2 * half + 1, axis=-1)[..., ::half]
    return WalkingPilot(
        model=plain,
        dt=factor * dt,
        time=time[places],
        measured=np.ascontiguousarray(control[:, places].T),
        inputs=np.ascontiguousarray(nodes.transpose(2, 3, 0, 1)),
        fine=(float(time[0]), dt / finer),
        lags=np.zeros((1, 3, 3)),
    )
