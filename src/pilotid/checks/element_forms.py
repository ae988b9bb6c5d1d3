"""Forms of controlled elements, fitted to windowed spectra by maximum likelihood."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from itertools import product
from typing import NamedTuple

import numpy as np

from pilotid.model.element import ControlledElement, element_named
from pilotid.recording.recording import Recording, remembered
from pilotid.solve.least_squares import Box, minimise, solve_linear
from pilotid.support.types import ComplexArray, FloatArray, IntArray


class Form(NamedTuple):
    """(b0 s + b1) e^{-delay s} / (s^k (s^d + a1 s^(d-1) + ..)), or b0 alone above.

    Attributes
    ----------
    integrators
        k.
    free
        Degree d of the free polynomial.
    zeros
        Degree of the numerator, 0 or 1.
    """

    integrators: int
    free: int = 0
    zeros: int = 0

    @property
    def size(self) -> int:
        """Number of its parameters: b0 and on, a1 and on, and the delay."""
        return 2 + self.zeros + self.free

    def element(self, values: FloatArray) -> ControlledElement:
        """The element that it is with numbers; it has no name."""
        begin = 1 + self.zeros
        bottom = (1.0, *values[begin:-1], *[0.0] * self.integrators)
        return ControlledElement(tuple(values[:begin]), bottom, values[-1])


def _written(polynomial: Sequence[float]) -> str:
    """A polynomial as users write it, in brackets if it is a sum."""
    powers = ("s^3", "s^2", "s", "")[-len(polynomial) :]
    terms = [f"{value:+.6g}{s}" for value, s in zip(polynomial, powers, strict=True) if value]
    text = "".join(terms).replace("+1s", "+s").removeprefix("+")
    return f"({text})" if len(terms) > 1 else text


#: Those of up to three poles, without a zero first, from the fewest parameters on.
FORMS = sorted(
    (Form(k, d, z) for k, d, z in product(range(3), range(4), range(2)) if z <= k + d <= 3),
    key=lambda form: (form.zeros, form.size),
)

#: Where loops cross over [rad/s].
OMEGA = np.geomspace(0.5, 6.0, 40)
#: Where responses of forms are compared [rad/s].
ALIKE = np.geomspace(0.5, 20.0, 50)
#: Relative error below which two responses count as one: nobody misses it, and few recordings
#: are better than that, as signals are held, integrated and stored.
UNNOTICED = 5e-3
#: The spectrum of the window sin^4(pi t/T), at multiples of 2 pi / T: its derivatives up to the
#: third vanish at the ends, enough for equations of order 4.
WINDOW = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 16.0
HIGHEST = 4  # order of an equation
#: Of so many bins one is used: those between are nearly their sum.
BIN_STEP = 2
#: Independent observations per bin used: the window makes neighbours alike,
#: (mean of w^2)^2 / mean of w^4 for each bin.
INDEPENDENT = BIN_STEP * (35.0 / 128.0) ** 2 / (6435.0 / 32768.0)


class Spectra(NamedTuple):
    """Windowed spectra of an input v and an output x; runs and bins in one row.

    As no end of a run shows in the window, the spectrum of a derivative in it is the sum of the
    spectrum times powers of j omega over neighbouring bins, and a delay turns each of them.

    Attributes
    ----------
    powers
        Powers of j omega, at the bins that are summed, shape (`HIGHEST` + 2, 5, n).
    given
        Of the derivatives of v, as summands, of the same shape.
    output
        Of the derivatives of x, shape (`HIGHEST` + 1, n).
    fine
        The band of every observation, even in the logarithm of frequency, shape (n,).
    wide
        The same with enough observations in each to tell a level of noise.
    size
        Mean power of the output in each fine band.
    """

    powers: ComplexArray
    given: ComplexArray
    output: ComplexArray
    fine: IntArray
    wide: IntArray
    size: FloatArray

    def inputs(self, count: int, delay: float) -> ComplexArray:
        """The first derivatives of v(t - delay), shape (count, n)."""
        s = self.powers[1]
        turned = np.exp(-delay * s[:, 0]) @ self.given[:count]  # each as the first observation
        return np.asarray(turned * np.exp(-delay * (s[2] - s[2, 0])))

    def rows(self, element: ControlledElement, poles: slice, divisor: float = 1.0) -> ComplexArray:
        """Slopes of the output by numbers of an element, and below what it leaves, shape (.., n).

        Parameters
        ----------
        element
            Its order is `HIGHEST` at most.
        poles
            Powers of s in the denominator whose numbers are free, as are those of the numerator
            and the delay.
        divisor
            With 0 the denominator that the equation is divided by counts as held.
        """
        top, bottom = np.array(element.numerator[::-1]), np.array(element.denominator[::-1])
        powers, inputs = self.powers[: len(bottom), 2], self.inputs(len(top) + 1, element.delay)
        below = bottom @ powers
        left = bottom @ self.output[: len(bottom)] - top @ inputs[:-1]
        by_pole = divisor * left / below * powers[poles] - self.output[poles]
        return np.array([*inputs[-2::-1], *by_pole[::-1], -top @ inputs[1:], left]) / below

    def level(self, left: ComplexArray, exact: FloatArray | float = UNNOTICED**2) -> FloatArray:
        """Variance of the noise at each observation, with a share of power that counts as exact."""
        return np.asarray(power(left, self.wide)[self.wide] + (exact * self.size)[self.fine])


def power(signal: ComplexArray, band: IntArray) -> FloatArray:
    """Mean power in each band."""
    return np.bincount(band, signal.real**2 + signal.imag**2) / np.bincount(band)


class FormFit(NamedTuple):
    """The best that a form can do.

    Attributes
    ----------
    form, values
        Parameters in the order of `Form`.
    steps
        Independent errors of the values, one a row, one standard error each: their covariance is
        ``steps.T @ steps``.
    criterion
        Bayesian information criterion.
    left
        Share of the output's amplitude that is left, 1 at most: the median over the logarithm of
        frequency where loops cross over.  A disturbance that was not recorded is in few bins, and
        below, what u does between samples makes x drift.
    """

    form: Form
    values: FloatArray
    steps: FloatArray
    criterion: float
    left: float

    @property
    def element(self) -> ControlledElement:
        """The element that it is; its delay is negative where u is late."""
        return self.form.element(self.values)

    def rounded(self) -> ControlledElement:
        """The element, each number as short as its error allows with the others held.

        Its name is its text, with six digits of each number at most.  A negative delay is none: an
        offset between the recorder's channels, no part of the element.
        """
        held = 1.0 / np.linalg.norm(np.linalg.inv(self.steps), axis=1)
        # Of one digit, of two and so on, the last the value itself: the first within its error.
        every = np.array([[float(f"{v:.{d}g}") for v in self.values] for d in range(1, 18)])
        shortest = np.argmax(np.abs(every - self.values) <= held, axis=0)
        numbers = every[shortest, np.arange(len(held))]
        numbers[-1] *= self.values[-1] > held[-1]
        element = self.form.element(numbers)
        top, bottom = _written(element.numerator), _written(element.denominator)
        late = f"exp(-{element.delay:.6g}s)" if element.delay else ""
        return element_named(f"{top}{late}/{bottom}".removesuffix("/1"))

    def error_at(self, omega: FloatArray) -> FloatArray:
        """Relative standard error of the frequency response at `omega` [rad/s], shape (n,)."""
        others = [self.form.element(self.values + step).response(omega) for step in self.steps]
        ratios = np.array(others) / self.element.response(omega)
        return np.asarray(np.linalg.norm(ratios - 1.0, axis=0))


def fitted_form(spectra: Spectra, form: Form) -> FormFit:
    """The most likely parameters of a form.

    Levels of the noise are at their best for every residual: the likelihood is the concentrated
    one, and the mean logarithm of the levels is what its least squares minimise.

    Raises
    ------
    LinAlgError
        If the form's numbers are beyond measure: it is no form for the recording.
    """
    poles = slice(form.integrators, form.integrators + form.free)

    def gram(sets: FloatArray, divisor: float = 1.0) -> FloatArray:
        grams = np.empty((len(sets), form.size + 1, form.size + 1))
        for values, products in zip(sets, grams, strict=True):
            rows = spectra.rows(form.element(values), poles, divisor)
            level = spectra.level(rows[-1]) if divisor else spectra.size[spectra.fine]
            table = (rows / np.sqrt(level)).view(float)
            products[:] = table @ table.T
            products[-1, -1] = level.size  # the squares that levels at their best leave
            products *= math.exp(np.mean(np.log(level)))
        return grams

    free = np.full(form.size - 1, np.inf)
    # A delay may be negative, as u may be late.
    box = Box(np.append(-free, -0.3), np.append(free, 0.6), np.zeros(form.size, dtype=bool))
    delays = (-0.2, -0.1, 0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)  # s
    starts = np.array([[0.0] * (1 + form.zeros) + [3.0] * form.free + [d] for d in delays])
    for _ in range(3 if form.free else 1):  # the equation divided by the last denominator
        starts, cost = solve_linear(gram(starts, 0.0), starts, range(form.size - 1), box.lower)
        starts = starts[np.argsort(cost, kind="stable")[:3]]
    # Independent observations in each band.
    count = INDEPENDENT * np.bincount(spectra.fine).astype(float)
    best = minimise(gram, starts, box, iterations=1).only([0])
    # To .03 of -2 log-likelihood.
    best = minimise(gram, best, box, tolerance=0.03 / (2.0 * count.sum()), iterations=25)
    values = best.values[0]
    *slopes, rest = spectra.rows(form.element(values), poles)
    omega = spectra.powers[1, 2].imag
    even = ((omega >= OMEGA[0]) & (omega <= OMEGA[-1])) / omega  # over the logarithm
    share = np.abs(rest / spectra.output[0])
    left = min(1.0, float(np.quantile(share, 0.5, weights=even, method="inverted_cdf")))
    # What counts as exact is no noise that averages out over a band: its error is one.  Noise in v,
    # such as fast remnant that sampling folds down, makes the response smaller by the power left.
    table = (slopes / np.sqrt(spectra.level(rest, (UNNOTICED**2 + left**4) * count))).view(float)
    # Cholesky's factor is refused where a number is not finite.
    steps = np.linalg.inv(np.linalg.cholesky(2.0 * INDEPENDENT * table @ table.T))
    criterion = 2.0 * count.sum() * math.log(best.cost[0]) + form.size * math.log(2.0 * count.sum())
    return FormFit(form, values, steps, criterion, left)


@remembered
def spectra_of(recording: Recording) -> Spectra:
    """Spectra of u + fd and of x in the measurement window of a recording."""
    signals = [recording.window(signal) for signal in (drive_of(recording), recording.x)]
    base = 2.0 * np.pi / recording.duration
    # Pilots leave next to nothing above 25 rad/s, and a constant offset reaches the first bins.
    bins = np.arange(3, int(25.0 / base) + 1, BIN_STEP) + np.arange(-2, 3)[:, None]
    powers = (1j * base * np.tile(bins, recording.runs)) ** np.arange(HIGHEST + 2)[:, None, None]
    unit = float(np.std(signals[1])) or 1.0  # of x, so that none is too large or too small
    given, summands = (
        np.fft.rfft(signal / unit)[:, bins].swapaxes(0, 1).reshape(5, -1) * WINDOW[:, None] * powers
        for signal in signals
    )
    output = summands[: HIGHEST + 1].sum(axis=1)
    # A level of noise is told from ten independent observations on.
    fine, wide = (_bands(powers[1, 2].imag, fewest) for fewest in (1.0, 10.0 / INDEPENDENT))
    return Spectra(powers, given, output, fine, wide, power(output[0], fine))


def _bands(omega: FloatArray, fewest: float) -> IntArray:
    """Which of eight bands every frequency is in, or of fewer, each with so many frequencies."""
    edges = [0.0]
    for edge in np.geomspace(omega.min(), omega.max(), 9)[1:-1].tolist():
        if min(np.sum((omega >= edges[-1]) & (omega < edge)), np.sum(omega >= edge)) >= fewest:
            edges.append(edge)
    return np.searchsorted(edges[1:], omega, side="right")


def simplest(fits: Sequence[FormFit]) -> FormFit:
    """Of the fits that nobody would tell from the best, the one with the fewest parameters.

    Their responses differ by no more than .5 %: the criterion finds in drift of x poles and zeros
    that nearly cancel.
    """
    best = min(fits, key=lambda f: f.criterion)
    wanted = best.element.response(ALIKE)
    alike = [f for f in fits if np.allclose(f.element.response(ALIKE), wanted, UNNOTICED, 0.0)]
    return min(alike, key=lambda f: (f.form.size, f.criterion))


def drive_of(recording: Recording) -> FloatArray:
    """What the element answers to."""
    return recording.u if recording.fd is None else recording.u + recording.fd


@remembered
def fits_of(recording: Recording) -> tuple[FormFit, ...]:
    """Forms fitted to the measurement window, the simplest first, up to one that describes it.

    Empty if the output does not move.
    """
    spectra, fits = spectra_of(recording), list[FormFit]()
    for form in FORMS if spectra.size.all() else ():
        if any(f.left <= 1e-4 for f in fits):
            break
        with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):
            fits.append(fitted_form(spectra, form))
    return tuple(fits)
