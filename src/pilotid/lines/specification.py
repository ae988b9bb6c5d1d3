"""Whether an estimate agrees with what the forcing functions' lines alone say of the pilot.

Hausman, *Specification tests in econometrics*, Econometrica 46(6), 1978, in the form of a score:
the equations at the lines, in the manner of `fourier` and without the remnant in the inputs, have
at an efficient estimate a score of mean zero whose covariance is F - F V F, with F their
information and V the estimate's covariance.  What makes a likelihood wrong (noise in e and x, a
remnant or a pilot of another form, a filter on one signal) moves it; what lines and the rest of a
recording suffer alike, such as a control that is recorded late, does not.
"""

from __future__ import annotations

import math

import numpy as np

from pilotid.estimates.applicability import lines_objection
from pilotid.estimates.parts import RemnantEstimate
from pilotid.estimates.specification import Specification
from pilotid.lines.coefficients import NEIGHBOURS, TREND, coefficients_of
from pilotid.lines.fit import Equations
from pilotid.pilot.model import PilotModel
from pilotid.recordings.detectors import band_end
from pilotid.recordings.recording import INPUTS, Recording
from pilotid.recordings.spectra import floors_of
from pilotid.types import FloatArray

#: Share of the lines' information by which its covariance may be wrong: F and V are estimates.
ALLOWED = 0.1
#: Share of the inputs' power at a line that must be no noise of the recorder.
CLEAR = 0.95
#: Lines whose power is averaged.
NEAR = 7


def specification_of(
    recording: Recording,
    model: PilotModel,
    values: FloatArray,
    covariance: FloatArray,
    remnant: RemnantEstimate,
) -> Specification | None:
    """The test of an efficient estimate; None where the forcing functions have too few lines.

    Parameters
    ----------
    recording, model
        What was fitted.
    values, covariance
        The estimate, shapes (parameters,) and (parameters, parameters).
    remnant
        The remnant's spectrum as it was estimated.
    """
    if model.changes or lines_objection(recording, model):
        return None
    lines = coefficients_of(recording, model, NEIGHBOURS, TREND)
    residuals = lines.residuals(model.response(lines.omega, values))
    omega = lines.omega[: lines.lines]
    power = _smoothed(omega, lines.power(residuals), remnant)
    # Lines that the recorder's noise reaches, or a filter, do not count in the estimate either.
    floors = floors_of(recording)
    inputs = tuple(dict.fromkeys(INPUTS[channel.input] for channel in model.channels))
    clear = np.interp(omega, floors.omega, floors.share(inputs)) >= CLEAR
    clear &= omega <= min(band_end(recording), remnant.omega[-1])
    power = np.where(clear, power, np.inf)
    equations = Equations(lines, model, power, removed=1.0, fitted=values)
    gram = equations.gram(values[None])[0]
    free = np.diag(covariance) > 0.0
    size = np.sqrt(np.diag(gram)[:-1])
    free &= size > 0.0
    scale = size[free]
    information = gram[:-1, :-1][np.ix_(free, free)] / np.outer(scale, scale)
    score = gram[:-1, -1][free] / scale
    own = covariance[np.ix_(free, free)] * np.outer(scale, scale)
    expected = information - information @ own @ information
    # In directions of which the lines tell next to nothing there is nothing to test.
    sizes, along = np.linalg.eigh(information)
    told = sizes > 1e-6
    root = along[:, told] / np.sqrt(sizes[told])
    variance = root.T @ expected @ root
    shares, turned = np.linalg.eigh(variance)
    shares = np.clip(shares, 0.0, 1.0) + ALLOWED
    statistic = float(np.sum((turned.T @ root.T @ score) ** 2 / shares))
    if not math.isfinite(statistic):
        return None
    from scipy.special import gammaincc

    return Specification(statistic, float(gammaincc(0.5 * shares.size, 0.5 * statistic)))


def _smoothed(omega: FloatArray, power: FloatArray, remnant: RemnantEstimate) -> FloatArray:
    """The remnant's power at the lines, by the shape of its spectrum.

    The bins beside a line tell it with few degrees of freedom, so that weights scatter.
    """
    order = np.argsort(omega, kind="stable")
    shape = np.interp(omega[order], remnant.omega, remnant.density)
    window = np.ones(min(NEAR, order.size))
    ratio = np.convolve(power[order] / shape, window, "same")
    found = np.empty_like(power)
    found[order] = shape * ratio / np.convolve(np.ones(order.size), window, "same")
    return found
