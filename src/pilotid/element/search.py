"""One form of controlled element fitted to windowed spectra."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pilotid.element.forms import Form
from pilotid.types import ComplexArray, FloatArray, IntArray

#: Relative error below which two responses count as one: nobody misses it, and few recordings
#: are better than that, as signals are held, integrated and stored.
UNNOTICED = 5e-3
BANDS = 8  # of frequency, each with a level of noise of its own
FEWEST = 10.0  # independent observations from which a level of noise is told
ITERATIONS = 25
ENOUGH = 0.01  # of -2 log-likelihood that the last step gains
LONGEST = 0.6  # s, of a delay
EARLIEST = -1.5  # samples: x may be stored that much ahead of u
#: The window sin^4(pi t/T) as a sum of cosines cos(2 pi k t/T): its derivatives up to the third
#: vanish at the ends, enough for equations of order 4.
COSINES = (3.0 / 8.0, -1.0 / 2.0, 1.0 / 8.0)
HIGHEST = 4  # derivative of the output
TAYLOR = 3  # order to which the window is expanded for a delay
#: Of so many bins one is used: those between are nearly their sum.
EACH = 2
#: Independent observations per bin used: the window makes neighbours alike,
#: (mean of w^2)^2 / mean of w^4 for each bin.
INDEPENDENT = EACH * (35.0 / 128.0) ** 2 / (6435.0 / 32768.0)
#: A constant offset reaches the bins below.
FIRST = len(COSINES)


@dataclass(frozen=True, eq=False)
class FormFit:
    """The best that a form can do.

    Attributes
    ----------
    form, values
        Parameters in the order of `Form.keys`.
    covariance
        Of the values.
    criterion
        Bayesian information criterion.
    unexplained
        Share of the output's power that is left, in each band.
    """

    form: Form
    values: FloatArray
    covariance: FloatArray
    criterion: float
    unexplained: FloatArray

    def scaled(self, gain: float) -> FormFit:
        """The same for an output that is larger by a factor."""
        by = np.ones(len(self.values))
        by[0] = gain
        covariance = self.covariance * np.outer(by, by)
        return replace(self, values=self.values * by, covariance=covariance)


class Bands:
    """Levels of noise by band of frequency: what is left, and what counts as exact.

    Attributes
    ----------
    fine
        Band of each observation, even in the logarithm of frequency, shape (n,).
    wide
        The same with enough observations in each to tell a level from what is fitted.
    output
        Mean power of the output in the fine bands.
    count
        Independent complex observations in the fine bands.
    """

    def __init__(self, spectra: Spectra) -> None:
        omega = spectra.omega
        self.each = spectra.each
        self.fine = _bands(omega, 1.0)
        self.wide = _bands(omega, FEWEST / (self.each * INDEPENDENT))
        self.output = self.power(spectra.output[0], self.fine)
        self.count = INDEPENDENT * self.each * np.bincount(self.fine)
        self._floor = (UNNOTICED**2 * self.output)[self.fine]
        self._size = np.log(self.output)[self.fine]

    def power(self, signal: ComplexArray, band: IntArray) -> FloatArray:
        """Mean power in each band."""
        square = np.bincount(band, signal.real**2 + signal.imag**2)
        return np.asarray(square / (self.each * np.bincount(band)))

    def unexplained(self, residual: ComplexArray) -> FloatArray:
        """Share of the output's power that is left, in each fine band."""
        return self.power(residual, self.fine) / self.output

    def level(self, residual: ComplexArray) -> FloatArray:
        """Variance of the noise at each observation."""
        return self.power(residual, self.wide)[self.wide] + self._floor

    def claimed(self, residual: ComplexArray) -> FloatArray:
        """The variance that counts in standard errors.

        What counts as exact is no noise that averages out over a band: its error is one.
        """
        exact = self.count[self.fine] * self._floor
        return np.asarray(self.power(residual, self.wide)[self.wide] + exact)

    def cost(self, level: FloatArray) -> float:
        """-2 log-likelihood, the levels at their best."""
        return float(2.0 * INDEPENDENT * self.each * np.sum(np.log(level) - self._size))


def _bands(omega: FloatArray, fewest: float) -> IntArray:
    """The band of every observation, from 0 on, each with so many at the least, shape (n,)."""
    edges: list[float] = []
    for edge in np.geomspace(omega.min(), omega.max(), BANDS + 1)[1:-1].tolist():
        begin = edges[-1] if edges else 0.0
        inside, beyond = (omega >= begin) & (omega < edge), omega >= edge
        if min(inside.sum(), beyond.sum()) >= fewest:
            edges.append(edge)
    return np.searchsorted(edges, omega, side="right")


class _Equation(NamedTuple):
    """Residual at the output, the delayed input's derivatives, and the denominator."""

    residual: ComplexArray
    inputs: ComplexArray
    below: ComplexArray


def _equation(spectra: Spectra, form: Form, values: FloatArray) -> _Equation:
    top, bottom = form.polynomials(values)
    inputs = spectra.delayed(len(top) + 1, float(values[-1]))
    below = np.asarray(np.polyval(bottom, spectra.s), dtype=complex)
    left = bottom[::-1] @ spectra.output[: len(bottom)] - top[::-1] @ inputs[: len(top)]
    return _Equation(np.asarray(left / below), inputs, below)


def _step(
    spectra: Spectra, form: Form, values: FloatArray, at: _Equation, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Gradient and information of half the weighted sum of squares."""
    residual, inputs, below = at
    above, under = form.slopes(values)
    top, _ = form.polynomials(values)
    columns = [-(p[::-1] @ inputs[: len(p)]) for p in above]
    columns += [
        p[::-1] @ spectra.output[: len(p)] - residual * np.polyval(p, spectra.s) for p in under
    ]
    columns.append(top[::-1] @ inputs[1 : 1 + len(top)])
    jacobian = np.array(columns) / below
    scaled = (jacobian * weight).conj()
    return np.real(scaled @ residual), np.real(scaled @ jacobian.T)


def _start(spectra: Spectra, form: Form, bands: Bands, delay: float) -> FloatArray:
    """By linear least squares, the equation divided by the last denominator found."""
    power, degree = form.integrators, form.free + 2 * form.lags
    s, output = spectra.s, spectra.output[power:]
    below = (1.0 + s / 3.0) ** degree * s**power
    weight = 1.0 / np.sqrt(bands.output)[bands.fine]
    inputs = spectra.delayed(1 + form.zero, delay)
    columns = np.concatenate([inputs[::-1], -output[:degree][::-1]])
    for _ in range(5 if degree else 1):
        scaled = columns * (weight / np.abs(below)) ** 2
        size = np.sqrt(np.real(np.einsum("in,in->i", scaled.conj(), columns)))
        matrix = np.real(scaled.conj() @ columns.T) / np.outer(size, size)
        goal = np.real(scaled.conj() @ output[degree]) / size
        found = np.linalg.lstsq(matrix, goal)[0] / size
        top, free = found[: 1 + form.zero], found[1 + form.zero :]
        below = np.polyval([1.0, *free], s) * s**power
    parts = [top[:1], top[1:] / top[0], free]
    if form.lags:
        # Of the polynomial's roots the two that are most alike become the lags.
        roots = np.roots([1.0, *free])
        roots = roots[np.argsort(np.abs(roots))]
        first = int(np.argmin(np.abs(roots[1:]) / np.abs(roots[:-1])))
        b = float(np.sqrt(np.abs(roots[first] * roots[first + 1])))
        others = np.delete(roots, [first, first + 1])
        parts = [
            top[:1] / b**2,
            parts[1],
            np.real(np.atleast_1d(np.poly(others)))[1:],
            np.array([b]),
        ]
    return np.concatenate([*parts, [delay]])


def fitted_form(
    spectra: Spectra, form: Form, bands: Bands, dt: float, delay: float = 0.0
) -> FormFit | None:
    """The most likely parameters of a form, by damped Gauss-Newton steps.

    Levels of the noise follow the residual from step to step, which makes the least of the
    concentrated likelihood.

    Parameters
    ----------
    spectra, form, bands
        What is fitted to what.
    dt
        Sampling interval [s].
    delay
        From which the search starts [s].

    Returns
    -------
    None where the form's numbers are beyond measure: it is no form for the recording.
    """
    with np.errstate(all="ignore"):
        try:
            return _searched(spectra, form, bands, dt, delay)
        except np.linalg.LinAlgError:
            return None


def _searched(
    spectra: Spectra, form: Form, bands: Bands, dt: float, delay: float
) -> FormFit | None:
    values = _start(spectra, form, bands, delay)
    at = _equation(spectra, form, values)
    level = bands.level(at.residual)
    cost, damping = bands.cost(level), 1e-4
    for _ in range(ITERATIONS):
        gradient, information = _step(spectra, form, values, at, 1.0 / level)
        scale = np.sqrt(np.diag(information))
        matrix, gain = information / np.outer(scale, scale), 0.0
        while damping < 1e4:
            step = np.linalg.solve(matrix + damping * np.eye(len(values)), gradient / scale)
            trial = values - step / scale
            trial[-1] = np.clip(trial[-1], EARLIEST * dt, LONGEST)
            there = _equation(spectra, form, trial)
            own = bands.level(there.residual)
            gain = cost - bands.cost(own)
            if gain > 0.0:
                values, at, level, cost = trial, there, own, cost - gain
                damping = max(0.1 * damping, 1e-10)
                break
            damping *= 10.0
        if not gain > ENOUGH:
            break
    _, information = _step(spectra, form, values, at, 1.0 / bands.claimed(at.residual))
    scale = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    if form.lags and values[-2] <= 0.0:
        return None
    if not (np.isfinite([cost, *values]).all() and np.isfinite(covariance).all()):
        return None
    return FormFit(
        form,
        values,
        covariance / (2.0 * INDEPENDENT),
        cost + len(values) * float(np.log(2.0 * bands.count.sum())),
        bands.unexplained(at.residual),
    )


def windowed(signal: FloatArray, dt: float, order: int, bins: IntArray) -> ComplexArray:
    """Fourier integrals of a signal times the derivatives of the window.

    Parameters
    ----------
    signal
        Shape (runs, samples).
    dt
        Sampling interval [s].
    order
        Highest derivative of the window.
    bins
        Multiples of 2 pi / T that are wanted, from `FIRST` on.

    Returns
    -------
    Array of shape (order + 1, runs, bins).
    """
    samples = signal.shape[1]
    spectrum = np.fft.fft(signal, axis=1) * dt
    result = np.zeros((order + 1, len(signal), bins.size), dtype=complex)
    for k, size in enumerate(COSINES):
        rate = 2.0 * np.pi * k / (samples * dt)
        for sign in (1, -1):
            # cos = (e^+ + e^-)/2; each is a shift by k bins, and a derivative a factor of j rate.
            shifted = 0.5 * size * spectrum[:, bins - sign * k]
            for j in range(order + 1):
                result[j] += (1j * sign * rate) ** j * shifted
    return result


@dataclass(frozen=True, eq=False)
class Spectra:
    """Windowed spectra of an input v and an output x; runs and frequencies in one row.

    Attributes
    ----------
    omega
        Frequencies [rad/s], shape (n,).
    output
        Of the derivatives of x, shape (`HIGHEST` + 1, n).
    parts
        Of the derivatives of v(t - delay), by powers of the delay, but for the factor
        e^{-s delay}; shape (derivatives, `TAYLOR` + 1, n).
    each
        Bins of runs that stand behind each of the n.
    """

    omega: FloatArray
    output: ComplexArray
    parts: ComplexArray
    each: float

    @cached_property
    def s(self) -> ComplexArray:
        """Laplace variable, shape (n,)."""
        return np.asarray(1j * self.omega)

    def delayed(self, count: int, delay: float) -> ComplexArray:
        """Of the first derivatives of v(t - delay), from the zeroth on, shape (count, n)."""
        powers = np.array([delay**p / math.factorial(p) for p in range(TAYLOR + 1)])
        late = np.exp(-self.s * delay)
        return np.asarray((powers @ self.parts[:count]) * late)


def spectra_of(
    dt: float, given: FloatArray, output: FloatArray, highest: float, zeros: int
) -> Spectra:
    """Windowed spectra of a recording.

    Parameters
    ----------
    dt
        Sampling interval [s].
    given, output
        v and x, shape (runs, samples).
    highest
        Highest frequency [rad/s].
    zeros
        Highest derivative of v that is wanted.
    """
    runs, samples = output.shape
    last = min(int(highest * samples * dt / (2.0 * np.pi)), int(0.4 * samples))
    bins = np.arange(FIRST, last + 1, EACH)
    order = zeros + TAYLOR
    columns = np.concatenate(
        [windowed(output, dt, HIGHEST, bins), windowed(given, dt, order, bins)]
    )
    if runs > len(columns):
        # More runs than signals tell no more than a triangular factor does.
        triangles = np.asarray(np.linalg.qr(columns.transpose(2, 1, 0), mode="r"))
        columns = triangles.transpose(2, 1, 0)
    rows = columns.shape[1]
    columns = columns.reshape(len(columns), -1)
    omega = np.tile(2.0 * np.pi * bins / (samples * dt), rows)
    bare, delayed = columns[: HIGHEST + 1], columns[HIGHEST + 1 :]
    return Spectra(
        omega,
        np.array([_derivative(bare, i, omega) for i in range(HIGHEST + 1)]),
        np.array(
            [
                [_derivative(delayed[p:], i, omega) for p in range(TAYLOR + 1)]
                for i in range(zeros + 1)
            ]
        ),
        runs / rows,
    )


def _derivative(bare: ComplexArray, order: int, omega: FloatArray) -> ComplexArray:
    """Of a signal's derivative, from those of the signal times the window's derivatives."""
    s = 1j * omega
    terms = [
        math.comb(order, j) * (-1.0) ** j * s ** (order - j) * bare[j] for j in range(order + 1)
    ]
    return np.asarray(sum(terms))
