"""Prediction of the control by a pilot model, with its exact Jacobian.

The prediction is u_hat = F^-1 [ sum over channels of H_c(jw; theta) F(input_c) ]:
delays are exact and Jacobians follow from the factors' log-derivatives.  Residual
and Jacobian can be filtered by a whitening filter on the way.  What a recording may not
tell (an offset of the control, the state in which slow fixed poles started) is a linear
nuisance term, which is projected out of both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.solve.least_squares import BLOCK
from pilotid.solve.smoothing import Penalty
from pilotid.time_domain.extension import _extended
from pilotid.time_domain.modulated import FineInput, fine_input
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
    fine
        Per channel, its input in samples if it varies in time, else None.  The entry of
        `spectra` is then one.
    penalty
        What is known of the parameters beside the recording: roughness; None for nothing.
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
    fine: tuple[FineInput | None, ...]
    penalty: Penalty | None

    @property
    def runs(self) -> int:
        """Number of runs."""
        return int(self.control_spectrum.shape[0])

    @property
    def block(self) -> int:
        """Parameter sets that are evaluated at once."""
        return BLOCK

    @property
    def samples(self) -> int:
        """Scored samples of all runs, less the nuisance terms fitted to each run."""
        return self.runs * (self.scored - len(self.terms))

    @property
    def residuals(self) -> int:
        """`samples`, and what the penalty counts for."""
        return self.samples + (self.penalty.rank if self.penalty else 0)

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
        responses = self.model.responses(self.s, values)
        for response, signal, varying in zip(
            responses, self.spectra, self.varying(values[None]), strict=True
        ):
            spectrum -= response * signal if varying is None else response * varying[0]
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
        for c, ((response, slopes), input_spectrum) in enumerate(
            zip(terms, self.spectra, strict=True)
        ):
            part = response[:, None, :] * input_spectrum
            fine, changing = self.fine[c], self.model.channels[c].changing
            if fine and changing:
                own = list(self.model.changing_indices[c])
                signal, by_own = fine.modulated_slopes(changing, values[:, own])
                spectrum[:, own] += part[:, None] * by_own
                part = part * signal
            spectrum[:, -1] -= part
            for index, slope in slopes:
                spectrum[:, index] += slope[:, None, :] * part if slope.ndim > 1 else slope * part
        if taps is not None:
            response = self.filter_response(taps)
            spectrum *= response[:, None, None] if response.ndim > 1 else response
        return spectrum

    def varying(self, values: FloatArray) -> list[ComplexArray | None]:
        """Per channel, the transform of its input where it varies, (sets, runs, bins), or None.

        Parameters
        ----------
        values
            Parameter sets, shape (sets, parameters).
        """
        return [
            fine.modulated(channel.changing, values[:, list(own)])
            if fine and channel.changing
            else None
            for fine, channel, own in zip(
                self.fine, self.model.channels, self.model.changing_indices, strict=True
            )
        ]

    def of_runs(self, runs: list[int]) -> Prediction:
        """The prediction of some runs alone."""
        return replace(
            self,
            spectra=tuple(spectrum[runs] for spectrum in self.spectra),
            control_spectrum=self.control_spectrum[runs],
            fine=tuple(fine and fine.of_runs(runs) for fine in self.fine),
        )

    def below(self, band: float) -> Prediction:
        """Itself: only a reduced prediction is any faster with fewer frequencies."""
        return self

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
    """Prepare the prediction of a recording's control in an analysis band [rad/s].

    Parameters
    ----------
    recording
        The recording; all its runs are predicted.
    model
        The pilot model.
    band
        What lies above this frequency [rad/s] is not used; None for the full sampling rate.
    """
    from scipy.fft import next_fast_len

    model = model.over(recording.duration)
    prepared: Prepared = prepare(recording, model, band)
    extension = min(round(EXTENSION / prepared.dt), prepared.control.shape[1] - 1)
    length = next_fast_len(prepared.control.shape[1] + 2 * extension, real=True)

    def transformed(signal: FloatArray, edges: FloatArray) -> ComplexArray:
        return np.fft.rfft(_extended(signal, edges, extension, prepared.dt), n=length)

    span = (prepared.control.shape[1], extension, length)
    fine = tuple(
        fine_input(recording, channel, float(prepared.time[0]), span, band)
        if channel.changing
        else None
        for channel in model.channels
    )
    return Prediction(
        model=model,
        dt=prepared.dt,
        s=_laplace(length, prepared.dt),
        spectra=tuple(
            channel.sign * transformed(signal, edges)
            if own is None
            else np.ones((recording.runs, length // 2 + 1), dtype=complex)
            for channel, signal, edges, own in zip(
                model.channels, prepared.inputs, prepared.edges, fine, strict=True
            )
        ),
        control_spectrum=transformed(prepared.control, np.zeros((0, 2, recording.runs))),
        length=length,
        first=extension + prepared.first,
        scored=prepared.control.shape[1] - prepared.first,
        terms=(0.0, *model.fixed_poles),
        fine=fine,
        penalty=None,
    )


def predict_circular(recording: Recording, model: PilotModel) -> Prediction:
    """The exact prediction of a recording that is one whole period, without remnant.

    Such a recording has no edges: its transform is the steady state itself.  The model must not
    vary in time.
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
        fine=(None,) * len(model.channels),
        penalty=None,
    )


def _laplace(length: int, dt: float) -> ComplexArray:
    return np.asarray(2j * np.pi * np.fft.rfftfreq(length, dt), dtype=complex)
