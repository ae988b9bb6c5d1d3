"""A pilot fitted to what the forcing functions make of the control, at their lines alone.

The model in its loop is set against the forced response (`Equations` with all of the remnant
removed).  That judges the pilot and nothing else.  The likelihood of the whole control does
not: a channel on the output can also predict the control as the inverse of the controlled
element does, x = Hc (u + fd), which no forced response mistakes for a pilot.  The lines know
less of gain and lead than the whole recording does, but their optimum lies in its basin.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pilotid.estimate.estimate import is_at_bound
from pilotid.estimate.loops import are_pilots
from pilotid.estimate.quantities import RemnantEstimate, Specification, score_test, spans_decade
from pilotid.estimate.warnings import lines_objection
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.recording.spectra import floors_of
from pilotid.solve.least_squares import Minima, Problem, minimise, search, solve_linear
from pilotid.spectral.coefficients import NEIGHBOURS, TREND, Coefficients, coefficients_of
from pilotid.support.limits import ESTIMATE
from pilotid.support.numbers import Z95, chi_squared_limit, covariance_of
from pilotid.support.types import ComplexArray, FloatArray

#: Share of the inputs' power at a line that must be no noise of the recorder.
CLEAR = 0.95
#: Lines whose power is averaged.
NEAR = 7
ROUNDS = 8  # in which leakage and power are found anew
#: Parameter sets evaluated at once where there are lines alone.
MANY = 64


@dataclass(frozen=True, eq=False)
class LinesFit:
    """A pilot that explains the forced response at the lines.

    Attributes
    ----------
    coefficients
        The recording's coefficients.
    model
        The pilot model.
    values
        Its parameters, shape (parameters,).
    power
        Power of the remnant at the lines that this pilot leaves, shape (n,).
    """

    coefficients: Coefficients
    model: PilotModel
    values: FloatArray
    power: FloatArray

    @cached_property
    def misfit(self) -> float:
        """Chi-squared of the equations at the lines."""
        equations = Equations(self.coefficients, self.model, self.power)
        return float(np.sum(equations.rows(self.values[None])[0, -1] ** 2))

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the misfit."""
        return 2 * self.coefficients.lines - len(self.values)

    @property
    def determined(self) -> bool:
        """Whether the lines tell every parameter: inside its bounds, and to a factor of ten.

        Errors are those of a misfit of one for each degree of freedom, or of the larger one there
        is.
        """
        model, values = self.model, self.values
        equations = Equations(self.coefficients, model, self.power, 1.0, values)
        size = max(1.0, self.misfit / max(self.freedom, 1))
        covariance = covariance_of(equations.gram(values[None])[0][:-1, :-1], size)
        if is_at_bound(model, values).any() or covariance is None:
            return False
        reach = Z95 * np.sqrt(np.diag(covariance)) / np.maximum(np.abs(values), 1e-300)
        reach = np.minimum(reach, 100.0)  # of which exp is a number still
        return not spans_decade(np.exp(-reach), np.exp(reach))[model.positive].any()

    def minimised(self, residuals: ComplexArray | None = None) -> LinesFit:
        """The same with the parameters that fit best under this power, from these ones.

        `residuals` are as of `Equations`.
        """
        given = self.coefficients, self.model, self.power, 1.0, self.values
        problem = Equations(*given, residuals)
        end = minimise(problem.gram, self.values[None], self.model, tolerance=1e-6)
        return replace(self, values=end.values[0])

    def again(self) -> LinesFit:
        """The same with the power and the leakage that these parameters leave, and a new fit."""
        coefficients = self.coefficients
        residuals = coefficients.residuals(self.model.response(coefficients.omega, self.values))
        return replace(self, power=coefficients.power(residuals)).minimised(residuals)


def fit_lines(
    recording: Recording,
    model: PilotModel,
    rng: np.random.Generator,
    *,
    starts: Sequence[FloatArray] = (),
    candidates: int = 48,
    refined: int = 6,
    same: float = 1e-4,
) -> LinesFit:
    """The pilot whose response in the loop to the forcing functions alone fits best.

    Parameters
    ----------
    recording, model
        What is fitted; `pilotid.estimate.warnings.lines_objection` has none.
    rng
        Draws the random starts.
    starts
        Starts that are minimised beside the random ones, each of shape (parameters,).
    candidates, refined
        Starts screened, and starts minimised, see `pilotid.solve.least_squares.search`.
    same
        Largest relative change of the parameters in the last round.
    """
    coefficients = coefficients_of(recording, model, NEIGHBOURS, TREND)
    residuals = coefficients.first_residuals()
    power = coefficients.power(residuals)
    first = Equations(coefficients, model, power, residuals=residuals)
    ends = search(first.gram, model, rng, candidates=candidates, refined=refined)
    pilot = best_pilot(recording, model, ends)
    if starts:
        points = np.array(starts)
        points, _ = solve_linear(first.gram(points), points, model.linear, model.lower)
        ends = minimise(first.gram, points, model, tolerance=1e-3, iterations=16)
        more = best_pilot(recording, model, ends)
        pilot = min((pilot, more), key=lambda minima: float(minima.cost[0]))
    fits = [LinesFit(coefficients, model, pilot.values[0], power)]
    for _ in range(ROUNDS):
        fits.append(fits[-1].again())
        before, values = fits[-2].values, fits[-1].values
        if np.all(np.abs(values - before) <= same * np.abs(before)):
            break
    stable = are_pilots(recording, model, np.array([fit.values for fit in fits]))
    # A round that leaves the pilots leads nowhere.
    left = np.flatnonzero(stable[:-1] & ~stable[1:])
    return fits[left[0] if left.size else -1]


def best_pilot(recording: Recording, model: PilotModel, ends: Minima) -> Minima:
    """The best end of a search whose loop is stable, or the best of all if none is."""
    pilots = (k for k, end in enumerate(ends.values) if are_pilots(recording, model, end[None])[0])
    return ends.only([next(pilots, 0)])


class Equations(Problem):
    """Residuals of U = sum of H I at the lines, less the trend of those at the bins beside.

    Times the sensitivity S = 1/(1 - sum of H G), with G the loop's way from the control to the
    inputs, this is the control less what the forcing functions make of it in the loop, and
    its derivative holds what the forcing functions excite alone.  Times a power of S it holds
    the rest of the remnant in the inputs.

    Parameters
    ----------
    coefficients
        The recording's coefficients.
    model
        The pilot model.
    power
        Power of the remnant in each equation, shape (n,).
    removed
        That power, from 0 to 1.
    fitted
        Parameters whose sensitivity the weights are told by, shape (parameters,); needed if
        `removed` is not 0.
    residuals
        Residuals at lines and bins whose leakage is taken from the control at the lines, which
        stand alone then, shape (runs, all); None for the trend of the bins beside them.
    """

    def __init__(
        self,
        coefficients: Coefficients,
        model: PilotModel,
        power: FloatArray,
        removed: float = 0.0,
        fitted: FloatArray | None = None,
        residuals: ComplexArray | None = None,
    ) -> None:
        lines = coefficients.lines
        # Real and imaginary parts have half the power each.
        scale = np.sqrt(2.0 / power)
        self._paths, self._removed = coefficients.paths, removed
        if removed and fitted is not None:
            responses = model.response(coefficients.omega[:lines], fitted)
            around = np.sum(responses * coefficients.paths, axis=0)
            scale = scale * np.abs(1.0 - around) ** removed

        def at_lines(signal: ComplexArray) -> ComplexArray:
            """What multiplies a response at the lines, shape (n,)."""
            return np.asarray(scale * coefficients.at_lines(signal[:, :lines]))

        def beside(signal: ComplexArray) -> ComplexArray:
            """What multiplies it at the bins beside them, shape (n, bins)."""
            matrix = np.zeros((lines, coefficients.omega.size), dtype=complex)
            turned = coefficients.weights[:, :, None] * signal[:, coefficients.beside]
            near = -coefficients.trend * np.mean(turned, axis=0)
            matrix[np.arange(lines)[:, None], coefficients.beside] = near
            return scale[:, None] * matrix[:, lines:]

        control, inputs = coefficients.control, coefficients.inputs
        self._lines = np.array([at_lines(signal) for signal in inputs])
        if residuals is None:
            self._at = model.at(coefficients.omega)
            self._control = at_lines(control) + beside(control).sum(axis=1)
            self._beside = tuple(beside(signal) for signal in inputs)
        else:
            self._at, self._beside, self.block = model.at(coefficients.omega[:lines]), (), MANY
            self._control = at_lines(control[:, :lines] - coefficients.leakage(residuals))

    def rows(self, values: FloatArray) -> FloatArray:
        """Standardised Jacobian and residual, shape (sets, parameters + 1, residuals)."""
        rows = self._at(values)
        at_lines = rows[..., : self._control.size]
        products = (at_lines * self._lines[:, None]).sum(axis=1)
        for c, inputs in enumerate(self._beside):
            products += rows[:, c, :, self._control.size :] @ inputs.T
        np.subtract(self._control, products[:, -1], out=products[:, -1])
        if self._removed:
            around = (at_lines * self._paths[:, None]).sum(axis=1)
            sensitivity = 1.0 / (1.0 - around[:, -1:])
            products[:, :-1] -= self._removed * sensitivity * around[:, :-1] * products[:, -1:]
            products *= sensitivity if self._removed == 1.0 else sensitivity**self._removed
        # Real and imaginary parts side by side.
        return np.asarray(products.view(float))


def specification_of(
    recording: Recording,
    model: PilotModel,
    values: FloatArray,
    covariance: FloatArray,
    remnant: RemnantEstimate,
    highest: float,
) -> Specification | None:
    """An efficient estimate tested against what the lines alone say; None without enough lines.

    Hausman, *Specification tests in econometrics*, Econometrica 46(6), 1978, in the form of a
    score: the equations at the lines, without the remnant in the inputs, have at an efficient
    estimate a score of mean zero and covariance F - F V F, with F their information and V the
    estimate's covariance.  A remnant or a pilot of another form moves it, and noise in e and x;
    what lines and the rest suffer alike, such as a control recorded late, does not.

    Parameters
    ----------
    recording, model
        What was fitted.
    values, covariance
        The estimate, shapes (parameters,) and (parameters, parameters).
    remnant
        The remnant's spectrum as it was estimated.
    highest
        Frequency up to which the recorder left something of the signals [rad/s].
    """
    if model.changes or lines_objection(recording, model):
        return None
    lines = coefficients_of(recording, model, NEIGHBOURS, TREND)
    residuals = lines.residuals(model.response(lines.omega, values))
    omega = lines.omega[: lines.lines]
    power = smoothed_power(lines, residuals, remnant)
    # Lines that the recorder's noise reaches, or a filter, do not count in the estimate either.
    floors = floors_of(recording)
    share = floors.share(channel.on for channel in model.channels)
    clear = np.interp(omega, floors.omega, share) >= CLEAR
    clear &= omega <= min(highest, remnant.omega[-1])
    power = np.where(clear, power, np.inf)
    equations = Equations(lines, model, power, removed=1.0, fitted=values)
    gram = equations.gram(values[None])[0]
    size = np.sqrt(np.diag(gram)[:-1])
    free = (np.diag(covariance) > 0.0) & (size > 0.0)
    scale = size[free]
    information = gram[:-1, :-1][np.ix_(free, free)] / np.outer(scale, scale)
    score = gram[:-1, -1][free] / scale
    scaled = covariance[np.ix_(free, free)] * np.outer(scale, scale)
    expected = information - information @ scaled @ information
    # In directions of which the lines tell next to nothing there is nothing to test.
    sizes, along = np.linalg.eigh(information)
    known = sizes > 1e-6
    if not known.any():
        return None
    root = along[:, known] / np.sqrt(sizes[known])
    left = root.T @ expected @ root
    tested = score_test(root.T @ score, left, ESTIMATE.least_by_lines, "fourier")
    # What the same model cannot tell in either way shows in what it leaves.
    misfit, freedom = float(gram[-1, -1]), 2 * int(clear.sum()) - int(free.sum())
    if not tested or freedom <= 0 or misfit <= chi_squared_limit(freedom, 1e-3):
        return tested
    return replace(tested, missed=math.sqrt(misfit / freedom))


def smoothed_power(
    lines: Coefficients, residuals: ComplexArray, remnant: RemnantEstimate
) -> FloatArray:
    """The remnant's power at the lines, shape (n,), by the shape of its spectrum.

    The bins beside a line tell it with few degrees of freedom, so that weights scatter.

    Parameters
    ----------
    lines, residuals
        Coefficients, and what a pilot leaves of them, shape (runs, all).
    remnant
        Tells the shape.
    """
    omega, power = lines.omega[: lines.lines], lines.power(residuals, for_weights=False)
    order = np.argsort(omega, kind="stable")
    shape = np.interp(omega, remnant.omega, remnant.density)
    smooth = np.empty_like(power)
    for place, line in enumerate(order):
        near = order[max(0, place - NEAR // 2) : place + NEAR // 2 + 1]
        # Lines of low frequency have bins beside them in common.
        freedom = lines.freedom * np.unique(lines.beside[near]).size / lines.beside.shape[1]
        smooth[line] = shape[line] * np.mean(power[near] / shape[near]) * freedom / (freedom - 1.0)
    return smooth
