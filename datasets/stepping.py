"""Simulation by time stepping, of loops that are not linear or not constant.

Every channel of a pilot on the error or the output answers after a delay: what it commands
within a block of time as long as the shortest delay follows from signals that are known already,
whatever the stick does.  The target is known beforehand, so a channel on it may look ahead.
So the loop is open within a block, and every linear part runs through it at once, discretised
exactly but for signals that are taken to be straight between steps (first-order hold).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pilotid.datasets.scenarios import ElementChange, Scenario
from pilotid.datasets.signals import samples_of
from pilotid.model.channel import Changing, Channel, share_passed
from pilotid.model.element import ControlledElement
from pilotid.support.types import FloatArray, InputError, IntArray

STEP = 0.005  # seconds, at most
RUN_UP = 60.0  # seconds before the recording, in which the start from rest is forgotten
#: Central differences over so many steps on either side, by the order of the derivative.
REACH = 2
STENCILS = {
    0: (0.0, 0.0, 1.0, 0.0, 0.0),
    1: (1 / 12, -8 / 12, 0.0, 8 / 12, -1 / 12),
    2: (-1 / 12, 16 / 12, -30 / 12, 16 / 12, -1 / 12),
}
TERMS = 16  # of the series of an exponential: steps are short beside what the element takes
BLOCK = 1000  # steps at once, where no channel answers to the loop


def stepped(
    scenario: Scenario, remnant: FloatArray, rms: float, step: float = STEP
) -> tuple[FloatArray, FloatArray]:
    """Control and output of a loop that changes, or has the scenario's violation in it.

    Parameters
    ----------
    scenario
        The scenario.
    remnant
        Remnant at the control from the first sample of the recording on, periodic, and so
        much longer than the recording that there is a run-up to it, shape (runs, period).
    rms
        Root mean square of the linear loop's control.
    step
        The longest step [s].

    Returns
    -------
    u, x
        At the recording's samples, shape (runs, samples).

    Raises
    ------
    InputError
        If a channel of the pilot on the error or the output answers at once.
    """
    dt = scenario.dt
    fine = math.ceil(dt / step - 1e-9)  # steps a sample
    h = dt / fine
    samples = round(scenario.run_in / dt) + round(scenario.duration / dt)
    before = min(round(RUN_UP / dt), remnant.shape[1] - samples)
    count = (before + samples) * fine
    seen = count + math.ceil(scenario.model.ahead / h)  # the target goes on for who looks ahead
    time = np.arange(seen) * h - (before + round(scenario.run_in / dt)) * dt
    noise = _finer(remnant, fine)[:, np.arange(-before * fine, samples * fine)]
    target, disturbance = samples_of(scenario.target, time), samples_of(scenario.disturbance, time)

    pilot = dict(zip(scenario.model.keys, scenario.values.tolist(), strict=True))
    paths = [_Path(channel, pilot, time, h) for channel in scenario.model.channels]
    block = min(path.block for path in paths)
    if block < 1:
        raise InputError(
            f"scenario {scenario.name}: a violation inside the loop is simulated in blocks of the "
            f"pilot's delays, which must be at least {h:g} s each; give it longer ones"
        )
    element: _Linear | SteppedElement
    if scenario.change is None:
        element = _Linear(scenario.element.numerator, scenario.element.denominator, h)
    else:
        element = SteppedElement(scenario.element, scenario.change, time)
    late = scenario.element.delay / h
    e, u, y, x = (np.zeros((len(noise), count)) for _ in range(4))
    given = {"e": e, "x": x, "ft": np.broadcast_to(target, (len(e), seen))}
    for begin in range(0, count, block):
        now = np.arange(begin, min(begin + block, count))
        command = noise[:, now]
        for path in paths:
            command = command + path.through(given[path.on], now)
        violation = scenario.violation
        u[:, now] = command if violation is None else violation.stick(command, rms)
        y[:, now] = element.through(u[:, now] + disturbance[now])
        x[:, now] = _delayed(y, now - late)
        e[:, now] = target[now] - x[:, now]
    recorded = slice(before * fine, None, fine)
    return u[:, recorded], x[:, recorded]


class _Linear:
    """A rational transfer function that signals run through in blocks."""

    def __init__(self, top: Sequence[float], bottom: Sequence[float], h: float) -> None:
        from scipy.signal import cont2discrete

        self.state: FloatArray | None = None
        if len(bottom) == 1:
            self.top, self.bottom = np.array([top[0] / bottom[0]]), np.ones(1)
            return
        plain = np.trim_zeros(np.asarray(top, dtype=float), "f")
        discrete = cont2discrete((plain, np.asarray(bottom, dtype=float)), h, method="foh")
        self.top, self.bottom = np.ravel(discrete[0]), np.ravel(discrete[1])

    def through(self, signal: FloatArray) -> FloatArray:
        """The answer to the next block of a signal, shape (runs, steps)."""
        from scipy.signal import lfilter

        if self.state is None:
            order = max(self.top.size, self.bottom.size) - 1
            self.state = np.zeros((len(signal), order))
        answer, self.state = lfilter(self.top, self.bottom, signal, zi=self.state)
        return np.asarray(answer)


class _Path:
    """A channel of a pilot: what varies in time, its delay, and the rest of it."""

    def __init__(
        self, channel: Channel, values: dict[str, float], time: FloatArray, h: float
    ) -> None:
        self.time, self.h = time, h
        self.changing = channel.changing
        self.derivative = channel.derivative if self.changing else 0
        delay, top, bottom = 0.0, [float(channel.sign)], [1.0]
        for factor in channel.factors:
            if isinstance(factor, Changing) or (self.changing and factor.derivative):
                continue
            parameters = [values[p.key] for p in factor.parameters]
            seconds = factor.seconds([np.array(v) for v in parameters])
            if seconds is not None:
                delay += float(seconds)
                continue
            above, below = factor.rational(parameters, 1)
            top = np.polymul(top, above).tolist()
            bottom = np.polymul(bottom, below).tolist()
        self.on, self.delay = channel.on, delay / self.h
        self.linear = _Linear(top, bottom, self.h)
        if self.changing:
            self.own = np.array([values[p.key] for p in self.changing.parameters])
            if self.derivative + self.changing.order not in STENCILS:
                raise InputError(
                    f"channel {channel.name}: a channel that varies in time is simulated with "
                    f"derivatives up to order {max(STENCILS)} of its input"
                )

    @property
    def block(self) -> int:
        """Steps that it can answer without knowing what comes."""
        if self.on == "ft":
            return BLOCK
        ahead = REACH + 1 if self.changing else 0
        return math.floor(self.delay + 1e-9) - ahead

    def through(self, given: FloatArray, now: IntArray) -> FloatArray:
        """Its part of the command at these steps, from all of its input before them."""
        places = np.asarray(now - self.delay)
        if self.changing is None:
            return self.linear.through(_delayed(given, places))
        # Interpolated first, modulated then: the input is smooth, what multiplies it need not be.
        time = self.time[now] - self.delay * self.h
        weights = self.changing.weights(time, self.own)
        parts = [
            weight * self._derived(given, places, self.derivative + order)
            for order, weight in enumerate(weights)
        ]
        return self.linear.through(sum(parts[1:], parts[0]))

    def _derived(self, given: FloatArray, places: FloatArray, order: int) -> FloatArray:
        """A derivative of a signal between its steps, by central differences."""
        total = np.zeros((len(given), places.size))
        for offset, weight in zip(range(-REACH, REACH + 1), STENCILS[order], strict=True):
            if weight:
                total += weight / self.h**order * _delayed(given, places + offset)
        return total


def _delayed(signal: FloatArray, places: FloatArray) -> FloatArray:
    """A signal (runs, steps) between its steps, at rest before the first."""
    near = np.round(places)
    places = np.where(np.abs(places - near) < 1e-6, near, places)
    below = np.floor(places).astype(int)
    above = np.minimum(below + (places > below), signal.shape[1] - 1)
    part = places - below
    at = (1.0 - part) * signal[:, np.maximum(below, 0)] + part * signal[:, np.maximum(above, 0)]
    return np.asarray(np.where(below >= 0, at, 0.0))


def _finer(signal: FloatArray, factor: int) -> FloatArray:
    """A periodic signal (runs, samples) at as many times its samples, nothing above its band."""
    length = factor * signal.shape[1]
    return np.asarray(factor * np.fft.irfft(np.fft.rfft(signal), n=length))


class SteppedElement:
    """The answer of an element that changes, in blocks of steps.

    Within a step the coefficients are those at its middle, and the input is straight.

    Parameters
    ----------
    before, change
        The element and what becomes of it.
    time
        Times of all steps [s], shape (steps,).
    """

    def __init__(self, before: ControlledElement, change: ElementChange, time: FloatArray) -> None:
        h = float(time[1] - time[0])
        order, ends = len(before.denominator) - 1, (before, change.after)
        forms = {(len(e.numerator), len(e.denominator), e.denominator[0], e.delay) for e in ends}
        if forms != {(1, order + 1, 1.0, 0.0)}:
            raise ValueError(
                "elements that change must be a gain over polynomials of one order that begin "
                "with 1, without delay"
            )
        share = share_passed(time + 0.5 * h, np.array([change.middle, change.rate]))
        # The coefficients keep their value for most of the time.
        shares, self._which = np.unique(share, return_inverse=True)
        gains = np.array([element.numerator[0] for element in ends])
        lower = np.array([element.denominator[:0:-1] for element in ends])
        part = np.stack([1.0 - shares, shares], axis=1)
        # States, input, and its slope: one matrix exponential holds all that a step does.
        matrix = np.zeros((len(shares), order + 2, order + 2))
        matrix[:, np.arange(order - 1), np.arange(1, order)] = 1.0
        matrix[:, order - 1, :order] = -(part @ lower)
        matrix[:, order - 1, order] = part @ gains
        matrix[:, order, order + 1] = 1.0 / h
        steps = _exponential(h * matrix)[:, :order]
        self._own = np.ascontiguousarray(steps[..., :order].transpose(0, 2, 1))
        self._by_last = steps[..., order] - steps[..., order + 1]
        self._by_new = steps[..., order + 1]
        self._order = order
        self._now = 0
        self._state = self._last = np.zeros((0, 0))

    def through(self, signal: FloatArray) -> FloatArray:
        """The answer to the next block of a signal, shape (runs, steps)."""
        first = self._now == 0
        if first:  # all is at rest, and the input begins here
            self._state, self._last = np.zeros((len(signal), self._order)), signal[:, :1]
        which = self._which[self._now + first - 1 : self._now + signal.shape[1] - 1]
        inputs = np.concatenate([self._last, signal], axis=1)[:, first:, None]
        given = inputs[:, :-1] * self._by_last[which] + inputs[:, 1:] * self._by_new[which]
        answer = np.empty(signal.shape)
        state = self._state
        answer[:, 0] = state[:, 0]
        for i, (free, part) in enumerate(
            zip(self._own[which], given.transpose(1, 0, 2), strict=True)
        ):
            state = state @ free + part
            answer[:, i + first] = state[:, 0]
        self._now += signal.shape[1]
        self._state, self._last = state, signal[:, -1:]
        return answer


def _exponential(matrices: FloatArray) -> FloatArray:
    """Exponentials of many small matrices of small steps, shape (n, m, m), by their series."""
    term = np.broadcast_to(np.eye(matrices.shape[-1]), matrices.shape)
    total = term.copy()
    for power in range(1, TERMS + 1):
        term = term @ matrices / power
        total += term
    return total
