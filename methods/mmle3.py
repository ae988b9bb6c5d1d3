"""The estimator of AIAA 2008-7109: output error by Gauss-Newton on a discrete state space.

Follows the paper, section III, and Milne's MMLE3 toolbox as it is described
there: 5th-order Pade delays, a hold for the inputs, zero initial state, no bounds,
W = RR^-1 renewed at every iteration, steps -(H + lambda I)^-1 g with a lambda that
shrinks as the cost falls, and Cramer-Rao bounds [H^-1]_ii^(1/2) as standard errors.
A fit fails, as the paper's did, when a step drives a time delay negative, and when it ends at
one so short that Pade approximants are lost in rounding.  There is one
start, the model's; the paper starts within 40 % of the truth.  It goes on until the cost settles
to 11 digits: fits of one recording from ten such starts then end within .05 % of one another.

Assumes a white remnant, and a start near the optimum.

Use it to compare with that paper, and for nothing else.

Do not use it for results: hold, Pade and zero initial state each bias the estimate, and the white
residual makes it inconsistent for a coloured remnant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np

from pilotid.estimate.estimate import Estimate, Outcome, failed
from pilotid.estimate.warnings import looking_ahead, varying
from pilotid.likelihood.estimates import make_estimate, too_short
from pilotid.likelihood.likelihood import Likelihood
from pilotid.likelihood.prediction import predict
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.support.numbers import covariance_of
from pilotid.support.types import ComplexArray, FloatArray

Hold = Literal["zoh", "foh"]
FINITE_DIFFERENCE = 1e-5  # relative step of the central differences
#: Seconds below which slopes by a delay are rounding: 15 % off at 2 ms, by a factor of six at 1 ms.
SHORTEST_DELAY = 3e-3
TIME_SCALE = 10.0  # rad/s; with time in units of 0.1 s the coefficients are of order one


@dataclass(frozen=True)
class MMLE3:
    """Output-error maximum likelihood on a discretised state-space model.

    Attributes
    ----------
    hold
        How the inputs run between samples: ``zoh`` constant, ``foh`` linear.
    pade_order
        Order of the delays' Pade approximants.
    damping
        First lambda, as a share of the mean diagonal element of H.
    iterations
        Iteration limit.
    tolerance
        Relative change of the cost at which the iteration ends.
    """

    hold: Hold = "zoh"
    pade_order: int = 5
    damping: float = 1e-3
    iterations: int = 400
    tolerance: float = 1e-11
    name: ClassVar[str] = "mmle3"
    libraries: ClassVar[tuple[str, ...]] = ("scipy.signal",)

    def objection(self, recording: Recording, model: PilotModel) -> str | None:
        """Why it cannot treat a model: it varies in time, or sees the target ahead."""
        return varying(model) or looking_ahead(model)

    def fit(self, recording: Recording, model: PilotModel, rng: np.random.Generator) -> Estimate:
        """Iterate from the model's start until the cost settles.

        Parameters
        ----------
        recording
            The recording; all its runs are fitted jointly.
        model
            The pilot model, whose start is the only one.
        rng
            Not used: nothing here is random.
        """
        output = _Output(self, recording, model)
        values = model.start.copy()
        predicted = output.predict(values)
        if not np.all(np.isfinite(predicted)):
            return failed(self.name, model, Outcome.DIVERGED)
        residual = output.control - predicted
        damping = self.damping
        for iteration in range(1, self.iterations + 1):  # noqa: B007 - it is reported
            cost = float(np.mean(residual**2))  # RR, whose inverse is W
            jacobian = output.jacobian(values)
            gradient = -jacobian @ residual.ravel() / cost
            hessian = jacobian @ jacobian.T / cost
            if not np.all(np.isfinite(hessian)):
                return failed(self.name, model, Outcome.DIVERGED)
            while True:
                lam = damping * np.trace(hessian) / len(values)
                step = -np.linalg.solve(hessian + lam * np.eye(len(values)), gradient)
                trial = values + step
                if any(trial[i] < 0.0 for i in model.delays):
                    return failed(self.name, model, Outcome.NEGATIVE_DELAY)
                left = output.control - output.predict(trial)
                # A diverging trial gives NaN, which is no improvement.
                improved = bool(np.mean(left**2) < cost)
                if improved or damping > 1e8:
                    break
                damping *= 10.0
            if not improved:
                break  # no step lowers the cost any more: rounding decides
            values, residual = trial, left
            damping *= 0.1
            if cost - float(np.mean(residual**2)) < self.tolerance * cost:
                break
        else:
            return failed(self.name, model, Outcome.NOT_CONVERGED)
        jacobian = output.jacobian(values)
        covariance = covariance_of(jacobian @ jacobian.T, float(np.mean(residual**2)))
        lost = [model.keys[i] for i in model.delays if values[i] < SHORTEST_DELAY]
        if covariance is None or lost:
            why = f"{lost[0]} ends near zero, where rounding makes its slopes" if lost else ""
            return failed(self.name, model, Outcome.SINGULAR, why)
        estimate = make_estimate(self.name, recording, model, values, covariance, converged=True)
        # There are no bounds here, so that none was reached.
        return replace(
            estimate,
            outcome=Outcome.CONVERGED,
            message="",
            iterations=iteration,
            remarks=too_short(Likelihood(output.prediction), values),
        )


class _Output:
    """The discretised model's output over the measurement window.

    It starts from rest at the beginning of the recording: a run-in lets it settle,
    without one the window begins with a transient that the pilot did not have.
    """

    def __init__(self, settings: MMLE3, recording: Recording, model: PilotModel) -> None:
        from scipy.fft import next_fast_len

        self._settings, self._model, self._dt = settings, model, recording.dt
        self._first, self._samples = recording.run_in, recording.u.shape[1]
        self.control = recording.u[:, self._first :]
        self.prediction = prediction = predict(recording, model)
        window, begin = prediction.window, prediction.window.before
        # Twice the signals at least, so that the convolution does not wrap around.
        self._length = next_fast_len(2 * self._samples, real=True)
        self._spectra = []
        for spectrum in prediction.spectra:
            signal = np.fft.irfft(spectrum, n=window.length)[:, begin : begin + self._samples]
            self._spectra.append(np.fft.rfft(signal, n=self._length))
        # A step along one parameter leaves channels that it does not move as they are.
        self._transform = lru_cache(maxsize=2 * len(model.channels))(self._transform_of)

    def predict(self, values: FloatArray) -> FloatArray:
        """Model output, shape (runs, samples); not finite where the model diverges."""
        total = np.zeros(self._spectra[0].shape, dtype=complex)
        polynomials = self._model.polynomials(values, self._settings.pade_order)
        with np.errstate(over="ignore", invalid="ignore"):
            for (top, bottom), spectrum in zip(polynomials, self._spectra, strict=True):
                total += self._transform(tuple(top), tuple(bottom)) * spectrum
            return np.fft.irfft(total, n=self._length)[:, self._first : self._samples]

    def jacobian(self, values: FloatArray) -> FloatArray:
        """Central differences of the output, shape (parameters, runs * samples)."""
        steps = np.diag(FINITE_DIFFERENCE * np.maximum(np.abs(values), 1e-3))
        differences = [self.predict(values + step) - self.predict(values - step) for step in steps]
        return np.array(differences).reshape(len(steps), -1) / (2.0 * np.diag(steps))[:, None]

    def _transform_of(self, top: tuple[float, ...], bottom: tuple[float, ...]) -> ComplexArray:
        pulse = pulse_response((top, bottom), self._dt, self._samples, self._settings.hold)
        return np.fft.rfft(pulse, n=self._length)


def pulse_response(
    rational: tuple[Sequence[float], Sequence[float]], dt: float, samples: int, hold: Hold
) -> FloatArray:
    """Response of a discretised transfer function to a unit pulse from rest, shape (samples,).

    Parameters
    ----------
    rational
        Numerator and denominator, highest power first.
    dt
        Sampling interval [s].
    samples
        Length of the response.
    hold
        ``zoh`` or ``foh``.
    """
    from scipy.signal import cont2discrete, tf2ss

    scaled = [
        np.asarray(p) * TIME_SCALE ** np.arange(len(p) - 1, -1, -1, dtype=float) for p in rational
    ]
    a, b, c, d = cont2discrete(tf2ss(*scaled), dt * TIME_SCALE, hold)[:4]
    # Rows [c; ca; caa; ...] times columns [b, a^m b, a^2m b, ...], each doubled in number by each
    # power of a.
    rows, power = c, a
    while len(rows) ** 2 < samples - 1:
        rows = np.concatenate([rows, rows @ power])
        power = power @ power
    columns = b
    while len(rows) * columns.shape[1] < samples - 1:
        columns = np.concatenate([columns, power @ columns], axis=1)
        power = power @ power
    return np.concatenate([d[0], (rows @ columns).T.ravel()[: samples - 1]])
