"""Forms of controlled elements, and one of them fitted to windowed spectra."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import TypeVar

import numpy as np

from pilotid.model.element import ControlledElement, element_named
from pilotid.recording.recording import Recording, remembered
from pilotid.support.limits import ELEMENT
from pilotid.support.types import ComplexArray, FloatArray, IntArray

T = TypeVar("T", FloatArray, ComplexArray)

DIGITS = 9  # decimals, or zeros, that are written out
DIFFERENCE = 1e-7  # relative step of the differences


@dataclass(frozen=True)
class Form:
    """K (s + z) e^{-delay s} / (s^k (s^d + a1 s^(d-1) + ..) (1 + s/b)^2), or parts of it.

    Attributes
    ----------
    integrators
        k.
    free
        Degree d of the free polynomial.
    lags
        Whether there are two equal lags.
    zero
        Whether there is a zero.
    """

    integrators: int
    free: int = 0
    lags: bool = False
    zero: bool = False

    @property
    def keys(self) -> list[str]:
        """Names of the parameters, the delay last."""
        free = [f"a{n}" for n in range(1, self.free + 1)]
        return ["K", *["z"] * self.zero, *free, *["b"] * self.lags, "delay"]

    def polynomials(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Numerator and denominator, highest power first."""
        begin = 1 + self.zero
        bottom = np.array([1.0, *values[begin : begin + self.free]])
        if self.lags:
            b = values[-2]
            bottom = np.convolve(bottom, [1.0 / b**2, 2.0 / b, 1.0])
        top = values[0] * np.array([1.0, *values[1:begin]])
        return top, np.concatenate([bottom, np.zeros(self.integrators)])

    def response(self, values: FloatArray, omega: FloatArray) -> ComplexArray:
        """Frequency response at `omega` [rad/s], shape (n,)."""
        top, bottom = (np.polyval(p, 1j * omega) for p in self.polynomials(values))
        return np.asarray(top / bottom * np.exp(-1j * omega * values[-1]))

    def response_error(
        self, values: FloatArray, covariance: FloatArray, omega: FloatArray
    ) -> FloatArray:
        """Relative standard error of the frequency response, shape (n,)."""
        response = self.response(values, omega)
        slopes = differences(lambda v: self.response(v, omega), values, response) / response
        power = np.einsum("in,ij,jn->n", slopes.conj(), covariance, slopes)
        return np.asarray(np.sqrt(np.abs(power.real)))

    def element(self, values: FloatArray, digits: tuple[int, ...]) -> ControlledElement:
        """The element with a name that `element_named` reads.

        Parameters
        ----------
        values
            The parameters, with a delay that is not negative.
        digits
            Decimals of each, negative for zeros before the point.
        """
        numbers = [_number(v, d) for v, d in zip(values.tolist(), digits, strict=True)]
        return element_named(self._name(dict(zip(self.keys, numbers, strict=True))))

    def _name(self, shown: dict[str, str]) -> str:
        delay, powers = shown["delay"], [f"s^{n}" if n > 1 else "s" * n for n in range(6)]
        top = shown["K"] + (f"(s{_signed(shown['z'])})" if self.zero else "")
        top += f"exp(-{delay}s)" if float(delay) else ""
        terms = [_signed(shown[f"a{n}"]) + powers[self.free - n] for n in range(1, self.free + 1)]
        free = f"({powers[self.free]}{''.join(terms)})" if self.free else ""
        lags = f"(1+s/{shown['b']})^2" if self.lags else ""
        bottom = powers[self.integrators] + free + lags
        alone = bottom in ("", powers[self.integrators], free)
        return top + (bottom and f"/{bottom}" if alone else f"/({bottom})")


def differences(function: Callable[[FloatArray], T], values: FloatArray, there: T) -> T:
    """Derivatives by each value, shape (values, n), of a function that is `there` (n,) at them."""
    steps = DIFFERENCE * np.maximum(np.abs(values), 1e-2) * np.eye(len(values))
    return np.array([(function(values + step) - there) / step.sum() for step in steps])


def _number(value: float, decimals: int) -> str:
    """A number with so many decimals, an exponent where it would be long."""
    if not -DIGITS <= decimals <= DIGITS:
        return f"{value:.6g}"
    text = f"{round(value, decimals):.{max(decimals, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def _signed(number: str) -> str:
    return number if number.startswith("-") else f"+{number}"


#: From the simplest on.
FORMS = (
    *(Form(k, free) for k, free in ((0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1))),
    *(Form(k, free) for k, free in ((0, 2), (1, 2), (0, 3))),
    *(Form(k, free, lags=True) for k, free in ((0, 0), (1, 0), (2, 0), (0, 1), (0, 2))),
    *(Form(k, free, zero=True) for k, free in ((1, 0), (2, 0), (0, 1), (1, 1))),
    *(Form(k, free, zero=True) for k, free in ((0, 2), (1, 2), (0, 3))),
)


#: Relative error below which two responses count as one: nobody misses it, and few recordings
#: are better than that, as signals are held, integrated and stored.
UNNOTICED = 5e-3
NOISY = 0.05  # share of x in a band that nothing explains, from which v or x is noisy there
BANDS = 8  # of frequency, each with a level of noise of its own
OBSERVATIONS = 10.0  # independent observations from which a level of noise is told
ITERATIONS = 25
LAST_GAIN = 0.03  # of -2 log-likelihood that the last step gains
LONGEST_DELAY = 0.6  # s, of a delay
EARLIEST_DELAY = -0.15  # s: x may be stored that much ahead of u
SHORT_DELAY = 0.05  # s, of a delay that a search from none may miss with a simpler form
#: The window sin^4(pi t/T) as a sum of cosines cos(2 pi k t/T): its derivatives up to the third
#: vanish at the ends, enough for equations of order 4.
COSINES = (3.0 / 8.0, -1.0 / 2.0, 1.0 / 8.0)
HIGHEST = 4  # derivative of the output
HIGHEST_FREQUENCY = 25.0  # rad/s; pilots leave next to nothing above
TAYLOR = 3  # order to which the window is expanded for a delay
#: Of so many bins one is used: those between are nearly their sum.
BIN_STEP = 2
#: Independent observations per bin used: the window makes neighbours alike,
#: (mean of w^2)^2 / mean of w^4 for each bin.
INDEPENDENT = BIN_STEP * (35.0 / 128.0) ** 2 / (6435.0 / 32768.0)
#: A constant offset reaches the bins below.
FIRST_BIN = len(COSINES)


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
    explained
        Share of the output's power that it explains [%].
    """

    form: Form
    values: FloatArray
    covariance: FloatArray
    criterion: float
    unexplained: FloatArray
    explained: float


@dataclass(frozen=True, eq=False)
class Spectra:
    """Windowed spectra of an input v and an output x of unit size; runs and bins in one row.

    Attributes
    ----------
    gain
        Size of x over that of v, as recorded.
    omega
        Frequencies [rad/s], shape (n,).
    output
        Of the derivatives of x, shape (`HIGHEST` + 1, n).
    given
        Of v(t - delay) and its derivative, by powers of the delay, but for the factor
        e^{-s delay}; shape (2, `TAYLOR` + 1, n).
    doubtful
        Share by which the response may be off in each fine band, however long the recording is.
    """

    gain: float
    omega: FloatArray
    output: ComplexArray
    given: ComplexArray
    doubtful: FloatArray | float = 0.0

    def delayed(self, count: int, delay: float) -> ComplexArray:
        """Of the first derivatives of v(t - delay), from the zeroth on, shape (count, n)."""
        powers = np.array([delay**p / math.factorial(p) for p in range(TAYLOR + 1)])
        return np.asarray((powers @ self.given[:count]) * np.exp(-1j * self.omega * delay))

    def residual(self, form: Form, values: FloatArray) -> ComplexArray:
        """What a form leaves of the output, shape (n,)."""
        return self._left(*form.polynomials(values), float(values[-1]))

    def slopes(self, form: Form, values: FloatArray, residual: ComplexArray) -> ComplexArray:
        """Derivatives of `residual` by each value, shape (values, n)."""

        def coefficients(values: FloatArray) -> FloatArray:
            return np.concatenate(form.polynomials(values))

        (top, bottom), delay = form.polynomials(values), float(values[-1])
        powers = (1j * self.omega) ** np.arange(len(bottom))[::-1, None]
        answers, output = self.delayed(len(top), delay)[::-1], self.output[: len(bottom)][::-1]
        by_coefficient = np.concatenate([-answers, output - powers * residual]) / (bottom @ powers)
        slopes = differences(coefficients, values, coefficients(values)) @ by_coefficient
        slopes[-1] = (self._left(top, bottom, delay + DIFFERENCE) - residual) / DIFFERENCE
        return np.asarray(slopes)

    def unexplained(self, element: ControlledElement) -> float:
        """Largest share of the output's amplitude in a band that an element leaves.

        It is infinite for an element of a higher order than is known of the signals.
        """
        top, bottom = (np.trim_zeros(p, "f") for p in (element.numerator, element.denominator))
        if len(bottom) > len(self.output) or len(top) > len(self.given):
            return math.inf
        left = self._left(np.array(top) / self.gain, np.array(bottom), element.delay)
        return math.sqrt(float((power(left, self.fine) / self.size).max()))

    def _left(self, top: FloatArray, bottom: FloatArray, delay: float) -> ComplexArray:
        """What polynomials, highest power first, and a delay leave of the output, shape (n,)."""
        answer = top[::-1] @ self.delayed(len(top), delay)
        below = np.polyval(bottom, 1j * self.omega)
        return np.asarray((bottom[::-1] @ self.output[: len(bottom)] - answer) / below)

    @cached_property
    def fine(self) -> IntArray:
        """The band of every observation, even in the logarithm of frequency, shape (n,)."""
        return self._bands(1.0)

    @cached_property
    def wide(self) -> IntArray:
        """The same with enough observations in each to tell a level of noise."""
        return self._bands(OBSERVATIONS / INDEPENDENT)

    def _bands(self, fewest: float) -> IntArray:
        edges: list[float] = []
        omega = self.omega
        for edge in np.geomspace(omega.min(), omega.max(), BANDS + 1)[1:-1].tolist():
            begin = edges[-1] if edges else 0.0
            inside, beyond = (omega >= begin) & (omega < edge), omega >= edge
            if min(inside.sum(), beyond.sum()) >= fewest:
                edges.append(edge)
        return np.searchsorted(edges, omega, side="right")

    @cached_property
    def size(self) -> FloatArray:
        """Mean power of the output in each fine band."""
        return power(self.output[0], self.fine)

    @cached_property
    def count(self) -> FloatArray:
        """Independent complex observations in each fine band."""
        return np.asarray(INDEPENDENT * np.bincount(self.fine))

    def level(self, residual: ComplexArray, exact: FloatArray | float = 1.0) -> FloatArray:
        """Variance of the noise at each observation, with so often what counts as exact."""
        share = UNNOTICED**2 * exact + np.square(self.doubtful) * self.count
        floor = (share * self.size)[self.fine]
        return np.asarray(power(residual, self.wide)[self.wide] + floor)

    def cost(self, level: FloatArray) -> float:
        """-2 log-likelihood, the levels at their best."""
        return float(2.0 * INDEPENDENT * np.sum(np.log(level / self.size[self.fine])))


def power(signal: ComplexArray, band: IntArray) -> FloatArray:
    """Mean power in each band."""
    return np.bincount(band, signal.real**2 + signal.imag**2) / np.bincount(band)


def _derivatives(bare: ComplexArray, omega: FloatArray) -> ComplexArray:
    """Of a signal's derivatives, from those of the signal times the window's derivatives."""
    s = 1j * omega
    return np.array(
        [
            sum(math.comb(i, j) * (-1.0) ** j * s ** (i - j) * bare[j] for j in range(i + 1))
            for i in range(len(bare))
        ]
    )


def _start(spectra: Spectra, form: Form, delay: float) -> FloatArray:
    """By linear least squares, the equation divided by the last denominator."""
    power, degree = form.integrators, form.free + 2 * form.lags
    s, output = 1j * spectra.omega, spectra.output[power:]
    below = (1.0 + s / 3.0) ** degree * s**power
    weight = 1.0 / np.sqrt(spectra.size)[spectra.fine]
    inputs = spectra.delayed(1 + form.zero, delay)
    columns = np.concatenate([inputs[::-1], -output[:degree][::-1]])
    for _ in range(5 if degree else 1):
        scaled = columns * (weight / np.abs(below)) ** 2
        size = np.sqrt(np.real(np.einsum("in,in->i", scaled.conj(), columns)))
        matrix = np.real(scaled.conj() @ columns.T) / np.outer(size, size)
        goal = np.real(scaled.conj() @ output[degree]) / size
        solution = np.linalg.lstsq(matrix, goal)[0] / size
        top, free = solution[: 1 + form.zero], solution[1 + form.zero :]
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


def fitted_form(spectra: Spectra, form: Form, delay: float = 0.0) -> FormFit:
    """The most likely parameters of a form, by damped Gauss-Newton steps.

    Levels of the noise follow the residual from step to step, which makes the least of the
    concentrated likelihood.

    Parameters
    ----------
    spectra, form
        What is fitted to what.
    delay
        From which the search starts [s].

    Raises
    ------
    LinAlgError
        If the form's numbers are beyond measure: it is no form for the recording.
    """

    def normal(level: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Gradient and information of half the weighted sum of squares at unit scale, and scale."""
        jacobian = spectra.slopes(form, values, residual)
        scaled = (jacobian / level).conj()
        information = np.real(scaled @ jacobian.T)
        scale = np.sqrt(np.diag(information))
        return np.real(scaled @ residual) / scale, information / np.outer(scale, scale), scale

    values = _start(spectra, form, delay)
    residual = spectra.residual(form, values)
    level = spectra.level(residual)
    damping = 1e-4
    for _ in range(ITERATIONS):
        (gradient, matrix, scale), gain = normal(level), 0.0
        while damping < 1e4:
            step = np.linalg.solve(matrix + damping * np.eye(len(values)), gradient)
            trial = values - step / scale
            trial[-1] = np.clip(trial[-1], EARLIEST_DELAY, LONGEST_DELAY)
            there = spectra.residual(form, trial)
            level_there = spectra.level(there)
            gain = spectra.cost(level) - spectra.cost(level_there)
            if gain > 0.0:
                values, residual, level = trial, there, level_there
                damping = max(0.1 * damping, 1e-10)
                break
            damping *= 10.0
        if not gain > LAST_GAIN:
            break
    # What counts as exact is no noise that averages out over a band: its error is one.
    _, matrix, scale = normal(spectra.level(residual, spectra.count))
    left = power(residual, spectra.fine)
    covariance = np.linalg.inv(matrix) / np.outer(scale, scale) / (2.0 * INDEPENDENT)
    criterion = spectra.cost(level) + len(values) * float(np.log(2.0 * spectra.count.sum()))
    finite = np.isfinite([criterion, *values]).all() and (np.diag(covariance) > 0.0).all()
    if not finite or (form.lags and values[-2] <= 0.0):
        raise np.linalg.LinAlgError
    unit = np.array([spectra.gain, *np.ones(len(values) - 1)])
    share = (spectra.count @ left) / (spectra.count @ spectra.size)
    return FormFit(
        form,
        values * unit,
        covariance * np.outer(unit, unit),
        criterion,
        left / spectra.size,
        100.0 * max(0.0, 1.0 - float(share)),
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
        Multiples of 2 pi / T that are wanted, from `FIRST_BIN` on.

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


def spectra_of(dt: float, given: FloatArray, output: FloatArray) -> Spectra:
    """Windowed spectra of a recording.

    Parameters
    ----------
    dt
        Sampling interval [s].
    given, output
        v and x, shape (runs, samples).
    """
    runs, samples = output.shape
    # Of unit size, so that no unit is too large or too small to reckon with.
    size, answer = (float(np.std(signal)) or 1.0 for signal in (given, output))
    last = min(int(HIGHEST_FREQUENCY * samples * dt / (2.0 * np.pi)), int(0.4 * samples))
    bins = np.arange(FIRST_BIN, last + 1, BIN_STEP)
    omega = np.tile(2.0 * np.pi * bins / (samples * dt), runs)
    bare = windowed(output / answer, dt, HIGHEST, bins).reshape(HIGHEST + 1, -1)
    late = windowed(given / size, dt, 1 + TAYLOR, bins).reshape(2 + TAYLOR, -1)
    parts = [_derivatives(late[p : p + 2], omega) for p in range(TAYLOR + 1)]
    return Spectra(
        answer / size, omega, _derivatives(bare, omega), np.array(parts).swapaxes(0, 1).copy()
    )


def forms_fitted(spectra: Spectra) -> list[FormFit]:
    """Forms from the simplest on, up to where one describes the recording.

    Noise in v, such as fast remnant that sampling folds down, makes the response smaller by the
    share of x that nothing explains.
    """
    fits = _pass(spectra, FORMS)
    if not fits:
        return []
    best = simplest(fits)
    doubtful = np.where(best.unexplained > NOISY, best.unexplained, 0.0)
    noisy = doubtful.any() and best.explained >= ELEMENT.sound
    if noisy and not np.any(spectra.doubtful):
        return forms_fitted(replace(spectra, doubtful=doubtful))
    if best.values[-1] > SHORT_DELAY:
        simpler = [form for form in FORMS if len(form.keys) < len(best.form.keys)]
        fits += _pass(spectra, simpler, float(best.values[-1]))
    # Of each form the best.
    fits.sort(key=lambda fit: fit.criterion)
    return list({fit.form: fit for fit in reversed(fits)}.values())


def _pass(spectra: Spectra, forms: Sequence[Form], delay: float = 0.0) -> list[FormFit]:
    fits: list[FormFit] = []
    by_size = sorted(forms, key=lambda form: len(form.keys))
    for _, alike in groupby(by_size, key=lambda form: len(form.keys)):
        for form in alike:
            with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):
                fits.append(fitted_form(spectra, form, delay))
        if any(fit.unexplained.max() <= UNNOTICED**2 for fit in fits):
            break
    return fits


def simplest(fits: Sequence[FormFit]) -> FormFit:
    """Of the fits that nobody would tell from the best, the one with the fewest parameters."""
    best = min(fits, key=lambda f: f.criterion)
    alike = [f for f in fits if np.all(f.unexplained <= best.unexplained + UNNOTICED**2)]
    return min(alike, key=lambda f: (len(f.values), f.criterion))


@remembered
def spectra_in_window(recording: Recording) -> Spectra:
    """Spectra of u + fd and of x in the measurement window of a recording."""
    signals = {"u": recording.u, "x": recording.x, "fd": recording.fd}
    parts = {n: recording.window(s) for n, s in signals.items() if s is not None}
    return spectra_of(recording.dt, parts["u"] + parts.get("fd", 0.0), parts["x"])


@remembered
def fits_of(recording: Recording) -> tuple[FormFit, ...]:
    """The forms fitted to the measurement window of a recording."""
    return tuple(forms_fitted(spectra_in_window(recording)))
