"""Forms of controlled elements, and one of them fitted to windowed spectra."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from pilotid.model.element import ControlledElement
from pilotid.recording.recording import Recording, remembered
from pilotid.support.limits import ELEMENT
from pilotid.support.types import ComplexArray, FloatArray, IntArray

DIFFERENCE = 1e-7  # relative step of the differences


@dataclass(frozen=True)
class Form:
    """K (s + z) e^{-delay s} / (s^k (s^d + a1 s^(d-1) + ..)), with a zero or without.

    Attributes
    ----------
    integrators
        k.
    free
        Degree d of the free polynomial.
    zero
        Whether there is a zero.
    """

    integrators: int
    free: int = 0
    zero: bool = False

    @property
    def size(self) -> int:
        """Number of its parameters: K, z if it has a zero, a1 and on, and the delay."""
        return 2 + self.zero + self.free

    def polynomials(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Numerator and denominator, highest power first."""
        begin = 1 + self.zero
        top = values[0] * np.array([1.0, *values[1:begin]])
        return top, np.array([1.0, *values[begin:-1], *np.zeros(self.integrators)])

    def response(self, values: FloatArray, omega: FloatArray) -> ComplexArray:
        """Frequency response at `omega` [rad/s], shape (n,)."""
        s, (top, bottom) = 1j * omega, self.polynomials(values)
        return np.asarray(np.polyval(top, s) / np.polyval(bottom, s) * np.exp(-values[-1] * s))

    def name(self, values: FloatArray) -> str:
        """Its text with numbers, which `element_named` reads; the delay is not negative."""
        powers = ["", "s", "s^2", "s^3"]
        gain, *signed, delay = (f"{value:{'+' if i else ''}.6g}" for i, value in enumerate(values))
        zero = f"(s{signed.pop(0)})" if self.zero else ""
        terms = [f"{a}{powers[self.free - n]}" for n, a in enumerate(signed, 1)]
        free = f"({powers[self.free]}{''.join(terms)})" if self.free else ""
        bottom = powers[self.integrators] + free
        if self.integrators and free:
            bottom = f"({bottom})"
        late = f"exp(-{delay[1:]}s)" if values[-1] else ""
        return f"{gain}{zero}{late}" + (bottom and f"/{bottom}")


#: Those of up to three poles, from the fewest parameters on.
FORMS = sorted(
    (
        Form(k, d, zero)
        for k, d, zero in product(range(3), range(4), (False, True))
        if zero <= k + d <= 3
    ),
    key=lambda form: form.size,
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
SHORT_DELAY = 0.05  # s, of a delay that a search from none may miss with a simpler form
EARLIEST_DELAY = -0.15  # s: x may be stored that much ahead of u
#: The spectrum of the window sin^4(pi t/T), at multiples of 2 pi / T: its derivatives up to the
#: third vanish at the ends, enough for equations of order 4.
WINDOW = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 16.0
HIGHEST = 4  # order of an equation
HIGHEST_FREQUENCY = 25.0  # rad/s; pilots leave next to nothing above
#: Of so many bins one is used: those between are nearly their sum.
BIN_STEP = 2
#: Independent observations per bin used: the window makes neighbours alike,
#: (mean of w^2)^2 / mean of w^4 for each bin.
INDEPENDENT = BIN_STEP * (35.0 / 128.0) ** 2 / (6435.0 / 32768.0)
#: A constant offset reaches the bins below.
FIRST_BIN = 3


@dataclass(frozen=True, eq=False)
class FormFit:
    """The best that a form can do.

    Attributes
    ----------
    form, values
        Parameters in the order of `Form`.
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

    def error_at(self, omega: FloatArray) -> FloatArray:
        """Relative standard error of the frequency response at `omega` [rad/s], shape (n,)."""
        here = self.form.response(self.values, omega)
        slopes = _slopes(lambda values: self.form.response(values, omega), self.values, here) / here
        variance = np.einsum("in,ij,jn->n", slopes.conj(), self.covariance, slopes)
        return np.asarray(np.sqrt(np.abs(variance)))


def _slopes(
    function: Callable[[FloatArray], ComplexArray], values: FloatArray, here: ComplexArray
) -> ComplexArray:
    """Differences of a function by each of its values, shape (values, n); `here` it is at them."""
    steps = DIFFERENCE * np.maximum(np.abs(values), 1e-2) * np.eye(len(values))
    return np.array([(function(values + step) - here) / step.sum() for step in steps])


@dataclass(frozen=True, eq=False)
class Spectra:
    """Windowed spectra of an input v and an output x of unit size; runs and bins in one row.

    As no end of a run shows in the window, the spectrum of a derivative in it is the sum of the
    spectrum times powers of j omega over neighbouring bins, and a delay turns each of them.

    Attributes
    ----------
    gain
        Size of x over that of v, as recorded.
    neighbours
        Frequencies of the bins that are summed, less that of the bin [rad/s], shape (5,).
    omega
        Frequencies [rad/s], shape (n,).
    given
        Of the derivatives of v, as summands, shape (`HIGHEST` + 1, 5, n).
    output
        Of the derivatives of x, shape (`HIGHEST` + 1, n).
    fine
        The band of every observation, even in the logarithm of frequency, shape (n,).
    wide
        The same with enough observations in each to tell a level of noise.
    size
        Mean power of the output in each fine band.
    count
        Independent complex observations in each fine band.
    doubtful
        Share by which the response may be off in each fine band, however long the recording is.
    """

    gain: float
    neighbours: FloatArray
    omega: FloatArray
    given: ComplexArray
    output: ComplexArray
    fine: IntArray
    wide: IntArray
    size: FloatArray
    count: FloatArray
    doubtful: FloatArray | float = 0.0

    def answer(self, top: FloatArray, delay: float) -> ComplexArray:
        """Of top(s) v(t - delay), highest power first, shape (n,)."""
        turned = np.outer(top[::-1], np.exp(-1j * delay * self.neighbours))
        answer = np.tensordot(turned, self.given[: len(top)], 2)
        return np.asarray(answer * np.exp(-1j * delay * self.omega))

    def residual(self, top: FloatArray, bottom: FloatArray, delay: float) -> ComplexArray:
        """What an element leaves of the output, shape (n,)."""
        left = bottom[::-1] @ self.output[: len(bottom)] - self.answer(top, delay)
        return np.asarray(left / np.polyval(bottom, 1j * self.omega))

    def unexplained(self, element: ControlledElement) -> float:
        """Largest share of the output's amplitude in a band that an element leaves.

        It is infinite for an element of a higher order than the window allows.
        """
        top, bottom = np.array(element.numerator) / self.gain, np.array(element.denominator)
        if len(bottom) > len(self.output):
            return math.inf
        left = power(self.residual(top, bottom, element.delay), self.fine)
        return math.sqrt(float((left / self.size).max()))

    def level(self, residual: ComplexArray, exact: FloatArray | float = 1.0) -> FloatArray:
        """Variance of the noise at each observation, with so often what counts as exact."""
        share = UNNOTICED**2 * exact + np.square(self.doubtful) * self.count
        return np.asarray(power(residual, self.wide)[self.wide] + (share * self.size)[self.fine])

    def cost(self, level: FloatArray) -> float:
        """-2 log-likelihood, the levels at their best."""
        return float(2.0 * INDEPENDENT * np.sum(np.log(level / self.size[self.fine])))


def power(signal: ComplexArray, band: IntArray) -> FloatArray:
    """Mean power in each band."""
    return np.bincount(band, signal.real**2 + signal.imag**2) / np.bincount(band)


def _start(spectra: Spectra, form: Form, delay: float) -> FloatArray:
    """By linear least squares, the equation divided by the last denominator."""
    s = 1j * spectra.omega
    *outputs, goal = spectra.output[form.integrators : form.integrators + form.free + 1]
    inputs = [spectra.answer(np.eye(1 + n)[0], delay) for n in range(form.zero, -1, -1)]
    rows = np.array([*inputs, *(-output for output in reversed(outputs)), goal])
    below = (1.0 + s / 3.0) ** form.free * s**form.integrators
    for _ in range(5 if form.free else 1):
        weighted = rows / (np.sqrt(spectra.size)[spectra.fine] * np.abs(below))
        table = np.concatenate([weighted.real, weighted.imag], axis=1)
        top, free = np.split(np.linalg.lstsq(table[:-1].T, table[-1])[0], [1 + form.zero])
        below = np.polyval([1.0, *free], s) * s**form.integrators
    return np.concatenate([top[:1], top[1:] / top[0], free, [delay]])


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

    def residual(values: FloatArray) -> ComplexArray:
        return spectra.residual(*form.polynomials(values), values[-1])

    def normal(level: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradient and information of half the weighted sum of squares."""
        slopes = _slopes(residual, values, left)
        scaled = (slopes / level).conj()
        return np.real(scaled @ left), np.real(scaled @ slopes.T)

    values, damping = _start(spectra, form, delay), 1e-4
    left = residual(values)
    level = spectra.level(left)
    for _ in range(ITERATIONS):
        (gradient, information), gain = normal(level), 0.0
        while damping < 1e4 and not gain > 0.0:
            damped = information + damping * np.diag(np.diag(information))
            trial = values - np.linalg.solve(damped, gradient)
            trial[-1] = np.clip(trial[-1], EARLIEST_DELAY, LONGEST_DELAY)
            there = residual(trial)
            gain = spectra.cost(level) - spectra.cost(spectra.level(there))
            damping *= 0.1 if gain > 0.0 else 10.0
        if gain > 0.0:
            values, left, level = trial, there, spectra.level(there)
        if not gain > LAST_GAIN:
            break
    # What counts as exact is no noise that averages out over a band: its error is one.
    _, information = normal(spectra.level(left, spectra.count))
    covariance = np.asarray(np.linalg.inv(information)) / (2.0 * INDEPENDENT)
    criterion = spectra.cost(level) + form.size * float(np.log(2.0 * spectra.count.sum()))
    finite = np.isfinite([criterion, *values]).all() and (np.diag(covariance) > 0.0).all()
    if not finite:
        raise np.linalg.LinAlgError
    unit = np.array([spectra.gain, *np.ones(form.size - 1)])
    unexplained = power(left, spectra.fine) / spectra.size
    explained = 100.0 * max(
        0.0, 1.0 - np.average(unexplained, weights=spectra.count * spectra.size)
    )
    covariance *= np.outer(unit, unit)
    return FormFit(form, values * unit, covariance, criterion, unexplained, explained)


@remembered
def spectra_of(recording: Recording) -> Spectra:
    """Spectra of u + fd and of x in the measurement window of a recording."""
    given, output = (recording.window(s) for s in (drive_of(recording), recording.x))
    runs, samples = output.shape
    # Of unit size, so that no unit is too large or too small to reckon with.
    size, answer = (float(np.std(signal)) or 1.0 for signal in (given, output))
    base = 2.0 * np.pi / (samples * recording.dt)
    last = min(int(HIGHEST_FREQUENCY / base), int(0.4 * samples))
    bins, near = np.arange(FIRST_BIN, last + 1, BIN_STEP), np.arange(5) - 2
    s = 1j * base * np.tile(bins + near[:, None], runs)
    drive, summands = (
        np.fft.rfft(signal)[:, bins + near[:, None]].swapaxes(0, 1).reshape(s.shape)
        * WINDOW[:, None]
        * s ** np.arange(HIGHEST + 1)[:, None, None]
        for signal in (given / size, output / answer)
    )
    omega = s[2].imag
    fine, wide = (_bands(omega, fewest) for fewest in (1.0, OBSERVATIONS / INDEPENDENT))
    known, count = summands.sum(axis=1), INDEPENDENT * np.bincount(fine).astype(float)
    return Spectra(
        answer / size, base * near, omega, drive, known, fine, wide, power(known[0], fine), count
    )


def _bands(omega: FloatArray, fewest: float) -> IntArray:
    """The band of every frequency, each with so many."""
    edges = [0.0]
    for edge in np.geomspace(omega.min(), omega.max(), BANDS + 1)[1:-1].tolist():
        if min(np.sum((omega >= edges[-1]) & (omega < edge)), np.sum(omega >= edge)) >= fewest:
            edges.append(edge)
    return np.searchsorted(edges[1:], omega, side="right")


def simplest(fits: Sequence[FormFit]) -> FormFit:
    """Of the fits that nobody would tell from the best, the one with the fewest parameters."""
    best = min(fits, key=lambda f: f.criterion)
    alike = [f for f in fits if np.all(f.unexplained <= best.unexplained + UNNOTICED**2)]
    return min(alike, key=lambda f: (len(f.values), f.criterion))


def drive_of(recording: Recording) -> FloatArray:
    """What the element answers to."""
    return recording.u if recording.fd is None else recording.u + recording.fd


@remembered
def fits_of(recording: Recording) -> tuple[FormFit, ...]:
    """Forms fitted to the measurement window of a recording.

    Noise in v, such as fast remnant that sampling folds down, makes the response smaller by the
    share of x that nothing explains.
    """
    spectra = spectra_of(recording)
    fits = _fits(spectra, 0.0)
    if fits and (best := simplest(fits)).explained >= ELEMENT.sound:
        doubtful = np.where(best.unexplained > NOISY, best.unexplained, 0.0)
        if doubtful.any():
            spectra = replace(spectra, doubtful=doubtful)
            fits = _fits(spectra, 0.0)
    delay = float(simplest(fits).values[-1]) if fits else 0.0
    return (*fits, *(_fits(spectra, delay) if delay > SHORT_DELAY else ()))


def _fits(spectra: Spectra, delay: float) -> list[FormFit]:
    """Forms from the simplest on, up to where one describes the recording."""
    fits: list[FormFit] = []
    for form in FORMS:
        good = (f for f in fits if f.unexplained.max() <= UNNOTICED**2)
        if any(fit.form.size < form.size for fit in good):
            break
        with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):
            fits.append(fitted_form(spectra, form, delay))
    return fits
