"""Pilots whose parameters are random walks: the state space of an unscented Kalman filter.

The channel's input is recorded, so that a delay asks for the recorded signal a while ago, between
its samples as well, and needs no state.  Two states are left, those of the neuromuscular system;
its step is exact for constant parameters and an input that is a parabola over the step.  A remnant
of first order is a third.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pilotid.pilot.factors import Delay, Factor, Neuromuscular, Polynomial
from pilotid.pilot.model import PilotModel
from pilotid.pilot.timevarying import product_of
from pilotid.recordings.recording import Recording
from pilotid.solve.least_squares import LogTransform
from pilotid.time_domain.prepare import decimation, derivative_kernel
from pilotid.time_domain.unscented import Filtered, Levels, block_diagonal, passed, run_filter
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
FINEST = 0.005  # seconds between samples between which an input is straight, at most
SHORTEST = 5.0  # seconds that must be left to filter


def unsuited(model: PilotModel) -> str | None:
    """Why the parameters of a model cannot walk here, or None."""
    plain = model.constant
    if len(plain.channels) > 1 or plain.channels[0].on != "e":
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


def _of_kind(factors: tuple[Factor, ...], kind: type[F]) -> list[F]:
    return [factor for factor in factors if isinstance(factor, kind)]


@dataclass(frozen=True, eq=False)
class WalkingPilot:
    """The system: parameters in an order of its own, and states of each run.

    The parameters are those of the constant model: neuromuscular frequency and damping, delay, then
    gains and leads; positive ones as logarithms.  States are the control over its standard
    deviation, its rate, and those of a remnant that is not white.

    Attributes
    ----------
    model
        The constant model.
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
    def _scale(self) -> LogTransform:
        return LogTransform(self.positive)

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
            found.append((factor, first, last))
            first = last
        return found

    @cached_property
    def _limits(self) -> tuple[FloatArray, FloatArray]:
        return self.to_walk(self.model.lower), self.to_walk(self.model.upper)

    def _coefficients(self, own: FloatArray) -> list[FloatArray]:
        """Of the input and its derivatives, each of shape (sets, points)."""
        return product_of(
            factor.coefficients([own[..., i] for i in range(first, last)])
            for factor, first, last in self._polynomials
        )


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

    plain = model.constant
    channel = plain.channels[0]
    factors = channel.dynamics
    kinds: tuple[type[Factor], ...] = (Neuromuscular, Delay, Polynomial)
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
    error = recording.input(channel.on)
    error = channel.sign * (error - error.mean(axis=1, keepdims=True)) / size

    def through(signal: FloatArray, kernel: FloatArray, order: int = 0) -> FloatArray:
        windows = sliding_window_view(signal, kernel.size, axis=1)
        beside = (span + 1 - kernel.size) // 2
        found = windows[:, beside : windows.shape[1] - beside] @ kernel[::-1]
        return np.asarray(found / recording.dt**order)

    measured = through(control, smoothing)
    known = np.array(
        [through(error, kernel, channel.derivative + i) for i, kernel in enumerate(kernels)]
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


#: Standard deviations at the start: of logarithms, and of a delay in seconds.
APART, APART_DELAY = 0.5, 0.05
#: Noise of the neuromuscular system over a step, as share of the control: it keeps covariances
#: positive.
MOTOR = 1e-3
#: White part of a remnant with a lag, as share of its standard deviation.
WHITE = 0.03
#: Distance of the sigma points over the root of the number of parameters.
SPREAD = 1.05
#: Least and largest standard deviation of a walk after a second, of logarithms.
SLOWEST, FASTEST = 1e-3, 0.7
USUAL_WALK, USUAL_LAG = 0.06, 0.2
LAGS = (0.02, 2.0)  # s
REMNANTS = (0.003, 1.5)  # standard deviation over that of the control
ELITE = 8
LEAST = 0.01  # weight of a set that is kept
WIDER = 1.3  # by how much the next round is wider than the best of those before


@dataclass(frozen=True, eq=False)
class Walks:
    """A pilot, where its filter starts, and which of its parameters walk together.

    Attributes
    ----------
    pilot
        The system.
    start
        Parameters in model order, shape (parameters,).
    groups
        Per level of the walks how far each parameter goes with it, shape (walks, parameters).
    remnant
        Standard deviation of the remnant to begin with, over that of the control.
    order
        Of the remnant: 0 for a white one, else white noise through so many equal lags, 1 or 2.
    """

    pilot: WalkingPilot
    start: FloatArray
    groups: FloatArray
    remnant: float
    order: int

    @property
    def usual(self) -> FloatArray:
        """Where the search begins: logarithms of the levels, shape (levels,)."""
        first = [USUAL_WALK] * len(self.groups) + [np.clip(self.remnant, *REMNANTS)]
        return np.asarray(np.log([*first, USUAL_LAG] if self.order else first), dtype=float)

    @property
    def bounds(self) -> FloatArray:
        """Logarithms of the least and the largest levels, shape (2, levels)."""
        pairs = [(SLOWEST, FASTEST)] * len(self.groups) + [REMNANTS]
        return np.asarray(np.log([*pairs, LAGS] if self.order else pairs), dtype=float).T

    @property
    def spread(self) -> float:
        """Distance of the sigma points."""
        return float(SPREAD * np.sqrt(len(self.start)))

    def system(self, levels: FloatArray) -> tuple[WalkingPilot, Levels]:
        """The system and its noise, for sets of logarithms of levels, shape (sets, levels)."""
        pilot, sets, count = self.pilot, len(levels), len(self.start)
        walks = np.exp(2.0 * levels[:, : len(self.groups)]) @ self.groups**2 * pilot.dt
        variance = np.exp(2.0 * levels[:, len(self.groups)])
        size = 2 + self.order
        first, noise = np.zeros((sets, size, size)), np.zeros((sets, size, size))
        mean = pilot.to_walk(self.start)
        rate = np.exp(mean[0])  # of the control's rate over the control
        first[:, :2, :2] = np.diag([1.0, rate**2])
        noise[:, :2, :2] = MOTOR**2 * first[:, :2, :2]
        error, step = variance, np.zeros((sets, 0, 0))
        if self.order:
            step, still = _lags(pilot.dt / np.exp(levels[:, -1]), self.order)
            left = variance[:, None, None] * still
            first[:, 2:, 2:], noise[:, 2:, 2:] = left, left - step @ left @ step.swapaxes(1, 2)
            error = WHITE**2 * variance
        apart = np.where(pilot.positive, APART, APART_DELAY)
        covariance = block_diagonal(np.tile(apart**2, (sets, 1)), first, pilot.runs)
        means = np.zeros((sets, len(covariance[0])))
        means[:, :count] = mean
        return pilot.with_remnant(step), Levels(walks, noise, error, means, covariance)

    def log_likelihood(self, levels: FloatArray) -> FloatArray:
        """Of sets of logarithms of levels, shape (sets,)."""
        return run_filter(*self.system(levels), self.spread)

    def passed(self, levels: FloatArray) -> Filtered:
        """What the filters of sets of logarithms of levels find at each step."""
        return passed(*self.system(levels), self.spread)


def _lags(share: FloatArray, order: int) -> tuple[FloatArray, FloatArray]:
    """Step of white noise behind one or two equal lags, and its covariance at rest.

    Parameters
    ----------
    share
        Length of a step over the lag, shape (sets,).
    order
        Number of lags; the last is the output, whose variance is 1.
    """
    still = np.array([[1.0]]) if order == 1 else np.array([[2.0, 1.0], [1.0, 1.0]])
    step = np.exp(-share)[:, None, None] * np.eye(order)
    if order == 2:
        step[:, 1, 0] = np.exp(-share) * share
    return step, still


@dataclass(frozen=True, eq=False)
class Found:
    """The end of a search.

    Attributes
    ----------
    walks
        What the levels are of.
    levels
        Logarithms of likely levels, the likeliest first, shape (sets, levels).
    weights
        How likely each set is, shape (sets,); their sum is 1.
    log_likelihood
        Of the likeliest; minus infinity if every filter broke down.
    """

    walks: Walks
    levels: FloatArray
    weights: FloatArray
    log_likelihood: float


def likeliest(
    choices: Sequence[Walks], rng: np.random.Generator, rounds: int, candidates: int, kept: int
) -> Found:
    """Search the levels, and of several remnants the likeliest by the first round.

    The likely sets are those of the last round, weighted for where it drew them: to take the
    best one alone would be to know the levels.

    Parameters
    ----------
    choices
        What is filtered, with other remnants.
    rng
        Draws the candidates.
    rounds, candidates
        Number of rounds, and of candidates in each.
    kept
        Most sets that are kept.
    """
    best, found = -np.inf, None
    for walks in choices:
        search = _Search(walks, rng)
        search.round(candidates)
        if found is None or search.worth.max() > best:
            best, found = float(search.worth.max()), search
    assert found is not None
    for _ in range(rounds - 1):
        found.round(candidates)
    return found.end(kept)


class _Search:
    """Sets of levels tried so far, and where the next are drawn."""

    def __init__(self, walks: Walks, rng: np.random.Generator) -> None:
        self.walks, self._rng = walks, rng
        self._low, self._high = walks.bounds
        self._middle = np.clip(walks.usual, self._low, self._high)
        wide = [1.0] * len(walks.groups) + [0.15] + [0.7] * (walks.order > 0)
        self._covariance = np.diag(np.square(wide))
        self.tried, self.worth = np.zeros((0, len(wide))), np.zeros(0)
        self._last, self._density = self.tried, self.worth

    def round(self, candidates: int) -> None:
        """Draw candidates, and move to where the best ones are."""
        root = np.linalg.cholesky(self._covariance)
        normal = self._rng.standard_normal((candidates, len(root)))
        normal[0] = 0.0
        top = _top(self.tried, self.worth)
        if top is not None:
            normal[1] = np.clip(np.linalg.solve(root, top - self._middle), -3.0, 3.0)
        drawn = np.clip(self._middle + normal @ root.T, self._low, self._high)
        self._density = -0.5 * np.sum(normal**2, axis=1)
        self._last = self.walks.log_likelihood(drawn)
        self.tried = np.concatenate([self.tried, drawn])
        self.worth = np.concatenate([self.worth, self._last])
        best = np.argsort(-self.worth, kind="stable")[:ELITE]
        best = best[np.isfinite(self.worth[best])]
        if best.size < 2:
            return
        self._middle = self.tried[best].mean(axis=0)
        own = np.diag(np.var(self.tried[best], axis=0) + 1e-3)
        self._covariance = WIDER**2 * (0.5 * np.cov(self.tried[best].T) + 0.5 * own)

    def end(self, kept: int) -> Found:
        """The likely sets of the last round."""
        first = int(np.argmax(self.worth))
        best = float(self.worth[first])
        if not np.isfinite(best):
            return Found(self.walks, self.tried[:1], np.ones(1), best)
        levels, worth = self.tried[-len(self._last) :], self._last - self._density
        order = np.argsort(-worth, kind="stable")[:kept]
        weights = np.exp(worth[order] - worth[order[0]])
        order = order[weights > LEAST * weights.sum()]
        weights = weights[: len(order)] / weights[: len(order)].sum()
        return Found(self.walks, levels[order], weights, best)


def _top(tried: FloatArray, worth: FloatArray) -> FloatArray | None:
    """Top of the parabola through the better half of the sets; None if it has none."""
    size = tried.shape[1]
    terms = 1 + size + size * (size + 1) // 2
    order = np.argsort(-worth, kind="stable")
    order = order[np.isfinite(worth[order])][: max(len(worth) // 2, terms + 4)]
    if len(order) < terms + 4:
        return None
    centre, scale = tried[order].mean(axis=0), tried[order].std(axis=0) + 1e-9
    z = (tried[order] - centre) / scale
    rows, columns = np.triu_indices(size)
    design = np.column_stack([np.ones(len(z)), z, z[:, rows] * z[:, columns]])
    found = np.linalg.lstsq(design, worth[order], rcond=None)[0]
    curvature = np.zeros((size, size))
    curvature[rows, columns] = found[1 + size :]
    curvature = curvature + curvature.T
    if np.linalg.eigvalsh(curvature)[-1] >= 0.0:
        return None
    step = np.clip(np.linalg.solve(curvature, -found[1 : 1 + size]), -3.0, 3.0)
    return np.asarray(centre + scale * step)
