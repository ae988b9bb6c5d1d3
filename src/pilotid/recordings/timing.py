"""Times of signals against one another: derivatives behind a filter, and regressions on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pilotid.support.types import FloatArray

#: Standard deviation of the Gaussian that all signals pass before times are compared [s].
SMOOTH = 0.06
#: Share of the control left unexplained from which shifts are sought.
MUCH = 1e-3


def derivatives(signal: FloatArray, dt: float, order: int, delay: float = 0.0) -> list[FloatArray]:
    """A delayed signal and its derivatives behind a Gaussian filter, without what ends reach."""
    centred = signal - signal.mean(axis=1, keepdims=True)
    omega = 2.0 * np.pi * np.fft.rfftfreq(signal.shape[1], dt)
    spectrum = np.fft.rfft(centred) * np.exp(-0.5 * (omega * SMOOTH) ** 2 - 1j * omega * delay)
    edge = math.ceil(6.5 * SMOOTH / dt)
    found = []
    for power in range(order + 1):
        response = spectrum * (1j * omega) ** power
        found.append(np.fft.irfft(response, n=signal.shape[1])[:, edge:-edge])
    return found


def regression(
    wanted: FloatArray, columns: Sequence[FloatArray], step: float
) -> tuple[FloatArray, FloatArray, float]:
    """Least squares: values, their standard errors by blocks of 2 s, and the share left."""
    table = np.stack([c.ravel() for c in columns], axis=1)
    size = np.sqrt(np.mean(table**2, axis=0)) + 1e-300
    table /= size
    target = wanted.ravel()
    inverse = np.linalg.inv(table.T @ table + 1e-12 * len(table) * np.eye(table.shape[1]))
    values = inverse @ (table.T @ target)
    left = target - table @ values
    scores = np.add.reduceat(
        table * left[:, None], np.arange(0, left.size, max(1, int(2.0 / step)))
    )
    covariance = inverse @ (scores.T @ scores) @ inverse
    share = float(left @ left) / (float(target @ target) or 1.0)
    return values / size, np.sqrt(np.diag(covariance)) / size, share


class Best(NamedTuple):
    """How much later u is [s], the share of fd, and what is left of u unexplained."""

    late: float
    error: float
    share: float
    share_error: float
    left: float
    other: float  # how much later fd is
    other_error: float


class Relation:
    """u(t + a) + b fd(t + f) = sum of c_j times the j-th derivative of x(t + c)."""

    REACH, OUTPUT = 1.2, 0.45  # s, by which u and x are shifted at most
    STEP = 0.05

    def __init__(self, signals: dict[str, FloatArray], dt: float) -> None:
        self.dt = dt
        self.reach = int(self.REACH / dt)
        self.every = max(1, int(0.045 / dt))
        self.control = derivatives(signals["u"], dt, 1)
        self.output = derivatives(signals["x"], dt, 4)
        self.forcing = derivatives(signals["fd"], dt, 1) if "fd" in signals else []

    def _cut(self, signal: FloatArray, shift: int) -> FloatArray:
        end = signal.shape[1] - self.reach + shift
        return signal[:, self.reach + shift : end : self.every]

    def _at(
        self, order: int, shifts: tuple[int, int], against_output: bool, runs: int | None = None
    ) -> tuple[FloatArray, FloatArray, float]:
        control, rate = (self._cut(s[:runs], shifts[0]) for s in self.control)
        columns = [-rate, *(self._cut(s[:runs], shifts[1]) for s in self.output[: order + 1])]
        columns.append(np.ones_like(control))
        columns += [-self._cut(s[:runs], 0) for s in self.forcing[: 2 if against_output else 1]]
        return regression(control, columns, self.every * self.dt)

    def best(self, order: int, *, against_output: bool = False, scanned: bool = True) -> Best:
        """The relation with the least left, of all shifts if without them much is."""
        shifts = (0, 0)
        found = self._at(order, shifts, against_output)
        step = max(1, round(self.STEP / self.dt))
        grid = range(-(self.reach // step) * step, self.reach, step)
        scanned = scanned and found[2] > MUCH
        left = self._at(order, shifts, against_output, 1)[2] if scanned else 0.0
        for moves in (0, 1, 0, 1) if scanned else ():  # by the first run
            for shift in grid:
                if (moves == 0 and not self.forcing) or (
                    moves == 1 and abs(shift * self.dt) > self.OUTPUT
                ):
                    continue
                tried = (shift, shifts[1]) if moves == 0 else (shifts[0], shift)
                other = self._at(order, tried, against_output, 1)[2]
                if other < 0.7 * left:
                    left, shifts = other, tried
        if shifts != (0, 0):
            found = self._at(order, shifts, against_output)
        (values, errors, share_left), (of_control, of_output) = found, shifts
        against = of_output * self.dt if against_output else 0.0
        place = order + 3
        share, share_error, other, other_error = 1.0, math.inf, 0.0, math.inf
        if self.forcing:
            share, share_error = float(values[place]), float(errors[place])
            if against_output:
                other = float(values[place + 1]) / share - against
                other_error = float(errors[place + 1]) / abs(share)
        return Best(
            float(values[0]) + of_control * self.dt - against,
            float(errors[0]),
            share,
            share_error,
            share_left,
            other,
            other_error,
        )
