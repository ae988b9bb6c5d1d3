"""Prediction of the control by a pilot model, with its exact Jacobian.

The prediction is u_hat = F^-1 [ sum over channels of H_c(jw; theta) F(input_c) ]:
delays are exact and Jacobians follow from the factors' log-derivatives.  Residual
and Jacobian can be filtered by a whitening filter on the way.  What a recording may not
tell (an offset of the control, the state in which slow fixed poles started) is a linear
nuisance term, which is projected out of both.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.time_domain.extension import _extended
from pilotid.time_domain.prepare import Prepared, prepare
from pilotid.types import ComplexArray, FloatArray

REACH = 20  # samples that a whitening filter may reach back
EXTENSION = 4.0  # seconds over which signals fade out beyond both ends of the recording


@dataclass(frozen=True, eq=False)
class Prediction:
    """A pilot model ready to predict one recording's control.

    Attributes
    ----------
    model
        The pilot model.
    dt
        Sampling interval of the scored samples [s].
    s
        Laplace variable at the bins of the transform, shape (bins,).
    spectra
        Per channel, the transform of its signed input, shape (runs, bins).
    control_spectrum
        Transform of the control, shape (runs, bins).
    length
        Length of the transform.
    first, scored
        Index of the first scored sample, and number of scored samples.
    terms
        Poles of the nuisance terms e^{pole t} [rad/s]: 0 for an offset, and the model's
        fixed poles for their free decay.
    """

    model: PilotModel
    dt: float
    s: ComplexArray
    spectra: tuple[ComplexArray, ...]
    control_spectrum: ComplexArray
    length: int
    first: int
    scored: int
    terms: tuple[float, ...]

    @property
    def runs(self) -> int:
        """Number of runs."""
        return int(self.control_spectrum.shape[0])

    @property
    def samples(self) -> int:
        """Scored samples of all runs, less the nuisance terms fitted to each run."""
        return self.runs * (self.scored - len(self.terms))

    @property
    def control(self) -> FloatArray:
        """Scored part of the control, shape (runs, scored)."""
        return self.samples_of(self.control_spectrum)

    def residual(self, values: FloatArray, taps: FloatArray | None = None) -> FloatArray:
        """Residual u - u_hat of one parameter set, nuisance terms included.

        Parameters
        ----------
        values
            Parameters, shape (parameters,).
        taps
            Whitening filter, shape (taps,).

        Returns
        -------
        Array of shape (runs, scored).
        """
        spectrum = self.control_spectrum.copy()
        for response, signal in zip(
            self.model.responses(self.s, values), self.spectra, strict=True
        ):
            spectrum -= response * signal
        if taps is not None:
            spectrum *= self.filter_response(taps)
        return self.samples_of(spectrum)

    def rows(self, values: FloatArray, taps: FloatArray | None = None) -> FloatArray:
        """Jacobian of the prediction, and below it the residual u - u_hat.

        Parameters
        ----------
        values
            Parameter sets, shape (sets, parameters).
        taps
            Whitening filter (moving average) of each set, shape (sets, taps), or one for
            all, shape (taps,).

        Returns
        -------
        Array of shape (sets, parameters + 1, runs, scored).
        """
        return self.samples_of(self.row_spectra(values, taps))

    def row_spectra(self, values: FloatArray, taps: FloatArray | None = None) -> ComplexArray:
        """The transforms of `rows`, shape (sets, parameters + 1, runs, bins)."""
        sets, count = values.shape
        spectrum = np.zeros((sets, count + 1, *self.control_spectrum.shape), dtype=complex)
        spectrum[:, -1] = self.control_spectrum
        terms = self.model.terms(self.s, values)
        for (response, slopes), input_spectrum in zip(terms, self.spectra, strict=True):
            part = response[:, None, :] * input_spectrum
            spectrum[:, -1] -= part
            for index, slope in slopes:
                spectrum[:, index] += slope[:, None, :] * part if slope.ndim > 1 else slope * part
        if taps is not None:
            response = self.filter_response(taps)
            spectrum *= response[:, None, None] if response.ndim > 1 else response
        return spectrum

    def filter_response(self, taps: FloatArray) -> ComplexArray:
        """Response of moving-average filters at the bins, shape (..., bins)."""
        return np.asarray(taps @ self._shifts[: taps.shape[-1]])

    @cached_property
    def _shifts(self) -> ComplexArray:
        """Responses of delays by 0 to REACH samples at the bins."""
        powers = np.ones((REACH + 1, self.s.size), dtype=complex)
        powers[1:] = np.exp(-self.s * self.dt)
        return np.asarray(np.cumprod(powers, axis=0), dtype=complex)

    @cached_property
    def nuisance_terms(self) -> FloatArray:
        """The nuisance terms, shape (scored, terms).

        Exponentials are eigenfunctions of filters: whitening only scales them, so that
        the space to project out is the same for every whitening filter.
        """
        return np.exp(np.outer(np.arange(self.scored) * self.dt, self.terms))

    @cached_property
    def nuisance_basis(self) -> FloatArray:
        """Orthonormal basis of the nuisance terms, shape (scored, terms)."""
        return np.asarray(np.linalg.qr(self.nuisance_terms).Q)

    def without_nuisance(self, rows: FloatArray) -> FloatArray:
        """Rows (..., scored) less their projection on the nuisance terms."""
        if not self.terms:
            return rows
        return rows - (rows @ self.nuisance_basis) @ self.nuisance_basis.T

    def samples_of(self, spectrum: ComplexArray) -> FloatArray:
        """The scored samples of transforms, shape (..., scored)."""
        signal = np.fft.irfft(spectrum, n=self.length)
        return signal[..., self.first : self.first + self.scored]


def predict(recording: Recording, model: PilotModel, band: float | None = None) -> Prediction:
    """Prepare the prediction of a recording's control in an analysis band [rad/s]."""
    from scipy.fft import next_fast_len

    prepared: Prepared = prepare(recording, model, band)
    extension = min(round(EXTENSION / prepared.dt), prepared.control.shape[1] - 1)
    length = next_fast_len(prepared.control.shape[1] + 2 * extension, real=True)

    def transformed(signal: FloatArray, edges: FloatArray) -> ComplexArray:
        return np.fft.rfft(_extended(signal, edges, extension, prepared.dt), n=length)

    return Prediction(
        model=model,
        dt=prepared.dt,
        s=_laplace(length, prepared.dt),
        spectra=tuple(
            channel.sign * transformed(signal, edges)
            for channel, signal, edges in zip(
                model.channels, prepared.inputs, prepared.edges, strict=True
            )
        ),
        control_spectrum=transformed(prepared.control, np.zeros((0, 2, recording.runs))),
        length=length,
        first=extension + prepared.first,
        scored=prepared.control.shape[1] - prepared.first,
        terms=(0.0, *model.fixed_poles),
    )


def predict_circular(recording: Recording, model: PilotModel) -> Prediction:
    """The exact prediction of a recording that is one whole period, without remnant.

    Such a recording has no edges: its transform is the steady state itself.
    """
    length = recording.samples
    s = _laplace(length, recording.dt)
    return Prediction(
        model=model,
        dt=recording.dt,
        s=s,
        spectra=tuple(
            channel.sign
            * np.fft.rfft(recording.window(recording.input(channel.input)))
            * s**channel.derivative
            for channel in model.channels
        ),
        control_spectrum=np.fft.rfft(recording.window(recording.u)),
        length=length,
        first=0,
        scored=length,
        terms=(),
    )


def _laplace(length: int, dt: float) -> ComplexArray:
    return np.asarray(2j * np.pi * np.fft.rfftfreq(length, dt), dtype=complex)
