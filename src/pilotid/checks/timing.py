"""Times of signals against one another: derivatives behind a filter, and regressions on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pilotid.checks.element_forms import INDEPENDENT, Spectra
from pilotid.model.element import ControlledElement
from pilotid.support.limits import RECORDER
from pilotid.support.types import FloatArray

#: Standard deviation of the Gaussian that all signals pass before times are compared [s].
SMOOTH = 0.06
#: Share of the control left unexplained from which shifts are sought.
MUCH = 1e-3
LATEST = 1.2  # s, by which an output may be late


def derivatives(signal: FloatArray, dt: float, order: int, delay: float = 0.0) -> list[FloatArray]:
    """A delayed signal and its derivatives behind a Gaussian filter, without what ends reach."""
    omega = 2.0 * np.pi * np.fft.rfftfreq(signal.shape[1], dt)
    spectrum = np.fft.rfft(signal - signal.mean(axis=1, keepdims=True))
    spectrum *= np.exp(-0.5 * (omega * SMOOTH) ** 2)
    slope = 1j * omega
    if delay:
        spectrum *= np.exp(-slope * delay)
    edge = math.ceil(6.5 * SMOOTH / dt)
    signals = []
    for _ in range(order + 1):  # in place: an hour at 1 kHz is large
        signals.append(np.fft.irfft(spectrum, n=signal.shape[1])[:, edge:-edge])
        spectrum *= slope
    return signals


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


class Answered(NamedTuple):
    """How much later x answers than an element says [s], and its standard error."""

    late: float
    error: float


def shifted(signal: FloatArray, dt: float, earlier: float) -> FloatArray:
    """A signal so much earlier, by straight lines between samples; its ends stay."""
    time = dt * np.arange(signal.shape[1])
    return np.array([np.interp(time + earlier, time, row) for row in signal])


def answered(spectra: Spectra, element: ControlledElement) -> Answered | None:
    """The time by which an output lags the answer of an element to its input.

    A disturbance that was not recorded spoils the bins near its lines, so that a median over bins
    is taken.

    Parameters
    ----------
    spectra
        Of input and output.
    element
        The element, with two derivatives of the input and `HIGHEST` of the output at most.
    """
    top, bottom = (np.trim_zeros(p, "f")[::-1] for p in (element.numerator, element.denominator))
    if len(top) > 2 or len(bottom) > len(spectra.output):
        return None
    output = np.asarray(bottom) @ spectra.output[: len(bottom)]
    answer = np.asarray(top) @ spectra.delayed(len(top), element.delay)
    ratio, omega = output / answer, spectra.omega
    unit = ratio / np.abs(ratio)
    times = np.arange(-LATEST, LATEST, 0.01)
    late = float(times[np.argmax(np.real(np.exp(1j * np.outer(times, omega)) @ (omega * unit)))])
    for _ in range(3):
        off = -np.angle(unit * np.exp(1j * omega * late))
        late += _weighted_median(off / omega, omega)
    turned = ratio * np.exp(1j * omega * late)
    gain = float(np.median(turned.real))
    left = float(np.median(np.abs(turned / gain - 1.0)))
    if not left**2 < RECORDER.left:
        return None
    # A median has 1.25 times the error of a mean; independent bins of the window are fewer.
    scatter = 1.25 * 1.48 * float(np.median(np.abs(np.angle(turned))))
    return Answered(late, scatter / math.sqrt(INDEPENDENT * float(omega @ omega)))


def _weighted_median(values: FloatArray, weights: FloatArray) -> float:
    order = np.argsort(values)
    share = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(share, 0.5 * share[-1])])


class Best(NamedTuple):
    """How much later u is than fd [s], the share of fd, and what is left of u unexplained."""

    late: float
    error: float
    share: float
    share_error: float
    left: float


class Relation:
    """(1 + z d/dt)(u(t + a) + b fd) = sum of c_j times the j-th derivative of x(t + c)."""

    REACH, OUTPUT = 1.2, 0.45  # s, by which u and x are shifted at most
    STEP, SMALL = 0.05, 0.12

    def __init__(self, signals: dict[str, FloatArray], dt: float) -> None:
        self.dt = dt
        self.reach = int(self.REACH / dt)
        self.every = max(1, int(0.045 / dt))
        self.control = derivatives(signals["u"], dt, 1)
        self.output = derivatives(signals["x"], dt, 4)
        self.forcing = derivatives(signals["fd"], dt, 1)

    def _cut(self, signal: FloatArray, shift: int) -> FloatArray:
        end = signal.shape[1] - self.reach + shift
        return signal[:, self.reach + shift : end : self.every]

    def _at(
        self, shifts: tuple[int, int], runs: int | None = None
    ) -> tuple[FloatArray, FloatArray, float]:
        control, rate = (self._cut(s[:runs], shifts[0]) for s in self.control)
        forcing, forced = (self._cut(s[:runs], 0) for s in self.forcing)
        columns = [-rate, -forcing, -(rate + forced), np.ones_like(control)]
        columns += [self._cut(s[:runs], shifts[1]) for s in self.output]
        return regression(control, columns, self.every * self.dt)

    def best(self) -> Best:
        """The relation with the least left, of all shifts if without them much is."""
        best = self._near((0, 0))
        if best.left <= MUCH:
            return best
        small, step = round(self.SMALL / self.dt), max(1, round(self.STEP / self.dt))
        fine = range(-small, small + 1, max(1, small // 10))
        coarse = range(-(self.reach // step) * step, self.reach, step)
        most = round(self.OUTPUT / self.dt)
        # x goes with fd if u is late, and with u if fd is.
        grid = sorted({*fine, *coarse})
        tried = [(own, other) for own in grid for other in {0, own} if abs(other) <= most]
        shifts = min(tried, key=lambda pair: self._at(pair, 1)[2])
        return min(best, self._near(shifts), key=lambda best: best.left)

    def _near(self, shifts: tuple[int, int]) -> Best:
        """The relation about shifts of u and x, as the derivative is right for small ones alone."""
        for _ in range(5):
            values, errors, left = self._at(shifts)
            share = float(values[1]) or 1.0
            late = float(values[0] + values[2] * (1.0 - 1.0 / share)) + shifts[0] * self.dt
            near = int(np.clip(round(late / self.dt), -self.reach, self.reach)), shifts[1]
            if near == shifts:
                break
            shifts = near
        return Best(late, float(errors[0]), share, float(errors[1]), left)
