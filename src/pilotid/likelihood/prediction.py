"""Prediction of the control by a pilot model, with its Jacobian.

The prediction is u_hat = F^-1 [ sum over channels of H_c(jw; theta) F(input_c) ]:
delays are exact, and Jacobians follow from the factors' log-derivatives.  Residual
and Jacobian can be filtered by a whitening filter on the way.  What a recording may not
tell (an offset of the control, the state in which slow fixed poles started) is a linear
nuisance term, which is projected out of both.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np

from pilotid.likelihood.band_likelihood import BandTerms, Weighting, group_begins
from pilotid.likelihood.prepare import FAR, REACH, Window, window_of
from pilotid.model.channel import Changing, Channel
from pilotid.model.factors import Evaluated, Response
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.support.limits import ESTIMATE
from pilotid.support.numbers import chi_squared_limit
from pilotid.support.types import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class FineInput:
    """The input of a channel that varies in time, beyond both ends of the recording.

    Attributes
    ----------
    changing
        What varies.
    ratio
        Number of fine samples for each sample of the band.
    signals
        The signed input and its derivatives, shape (order + 1, runs, samples); the samples are
        those of the whole transform, a few for each of its own.
    time
        From the start of the measurement window [s], shape (samples,).
    """

    changing: Changing
    ratio: int
    signals: FloatArray
    time: FloatArray

    def modulated(self, window: Window, values: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Transforms of the modulated input and of its derivatives by what varies.

        Parameters
        ----------
        window
            Of the band.
        values
            Sets of the parameters of what varies, shape (sets, parameters).

        Returns
        -------
        Arrays of shape (sets, runs, bins) and (sets, parameters, runs, bins).
        """
        modulated = self.changing.modulated(self.signals, self.time, values)
        signal, slopes = (window.decimated(np.fft.rfft(m), self.ratio) for m in modulated)
        return signal, slopes


def fine_input(recording: Recording, channel: Channel, window: Window) -> FineInput:
    """The input of a channel in fine samples."""
    assert channel.changing is not None
    factor = window.band.factor
    # A change at the highest rate, 100 1/s, has its middle between samples of .02 s.
    steps = [d for d in range(1, factor) if factor % d == 0 and d * recording.dt <= 0.02 + 1e-9]
    step = max(steps, default=1)
    ratio = factor // step
    count, orders = window.length * ratio, range(channel.changing.order + 1)
    signal = channel.sign * recording.input(channel.on)
    spectra = [window.spectrum(signal, ratio, channel.derivative + order) for order in orders]
    signals = np.fft.irfft(np.array(spectra), n=count)
    time = recording.time[0] + (np.arange(count) * step - window.before) * recording.dt
    return FineInput(channel.changing, ratio, signals, time)


#: Largest width of a bin of the binned spectra [rad/s]: a delay of 1 s turns by 20 deg over it.
MAX_BINNED_WIDTH = 0.35
BESIDE = 1.05  # ratio of the time constants of decays about one: it, and its slope


@dataclass(frozen=True, eq=False)
class Prediction:
    """A pilot model ready to predict one recording's control.

    Attributes
    ----------
    model
        The pilot model.
    window
        Where the recording lies among the samples of the analysis band, and what is scored.
    s
        Laplace variable at the bins of the transform, shape (bins,).
    spectra
        Per channel, the transform of its signed input, shape (runs, bins).
    control_spectrum
        Transform of the control, shape (runs, bins).
    time
        Time of the scored samples [s], shape (scored,).
    pre_history
        Time before the first of them from which the inputs are known [s].
    nuisance_poles
        Poles of the nuisance terms e^{pole t} [rad/s]: 0 for an offset, and the model's
        fixed poles for their free decay.
    fine
        By their indices, the inputs in samples of channels that vary in time, whose entries of
        `spectra` are one.
    weighting
        How frequencies count in the likelihood of the band; None for direct prediction errors.
    weights, counted
        Of spectra that are reduced to few frequencies their weights, shape (bins,), and the number
        of samples that they stand for; None, 0 of samples.
    """

    model: PilotModel
    window: Window
    s: ComplexArray
    spectra: tuple[ComplexArray, ...]
    control_spectrum: ComplexArray
    time: FloatArray
    pre_history: float
    nuisance_poles: tuple[float, ...]
    fine: dict[int, FineInput]
    weighting: Weighting | None = None
    weights: FloatArray | None = None
    counted: int = 0

    @property
    def dt(self) -> float:
        """Sampling interval of the scored samples [s]."""
        return self.window.band.dt

    @property
    def runs(self) -> int:
        """Number of runs."""
        return int(self.control_spectrum.shape[0])

    def outlasting_lag(self, values: FloatArray) -> float:
        """The slowest lag of a pilot whose free decay outlasts the pre-history [s]; 0 for none.

        Parameters
        ----------
        values
            Parameters, shape (parameters,).
        """
        lag = self.model.slowest_lag(values)
        # After four time constants a decay is over.
        return lag if 0.0 < 0.25 * self.pre_history < lag else 0.0

    def with_decays(self, values: FloatArray) -> Prediction:
        """The same with the free decay of the slowest lag, where it outlasts the pre-history.

        Two exponentials take up the decay and its change with the time constant, which one alone
        would hold where it was.  Of a lag that is longer than the pre-history they are those of
        once and twice that: about the lag itself they would hide what the recording tells of it.

        Parameters
        ----------
        values
            Parameters, shape (parameters,).
        """
        lag, known = self.outlasting_lag(values), self.pre_history
        if not lag:
            return self
        times = (lag / BESIDE, lag * BESIDE) if lag <= known else (known, 2.0 * known)
        return replace(self, nuisance_poles=(*self.nuisance_poles, *(-1.0 / t for t in times)))

    @cached_property
    def band_terms(self) -> BandTerms | None:
        """What the likelihood of the band has beside squares; None for direct prediction errors."""
        if self.weighting is None:
            return None
        return BandTerms(
            self.weighting, self.dt, self.window.scored, self.runs, self.nuisance_poles
        )

    @cached_property
    def loop(self) -> Prediction:
        """`loop_at` the groups of bins of `band_terms` that count."""
        assert self.band_terms is not None
        return self.loop_at(self.band_terms.omega[: self.band_terms.counting])

    def loop_at(self, omega: FloatArray) -> Prediction:
        """A prediction whose `residual_spectra` are 1 + L(jw), and `row_spectra` the slopes of it.

        It has transforms alone, and no samples.

        Parameters
        ----------
        omega
            Frequencies [rad/s], shape (bins,).
        """
        assert self.weighting is not None
        s = np.asarray(1j * omega, dtype=complex)
        plant = self.weighting.element.response(omega)
        moved = {"e": -1.0, "x": 1.0, "ft": 0.0}  # by x: e = ft - x
        spectra = tuple(
            (channel.sign * moved[channel.on] * plant * s**channel.derivative)[None]
            for channel in self.model.channels
        )
        one = np.ones((1, omega.size), dtype=complex)
        return replace(self, s=s, spectra=spectra, control_spectrum=one)

    @property
    def control(self) -> FloatArray:
        """Scored part of the control, shape (runs, scored)."""
        return self.samples_of(self.control_spectrum)

    def errors(self, values: FloatArray, taps: FloatArray | None = None) -> FloatArray:
        """Residual u - u_hat, whitened if need be, with nuisance terms projected out.

        Parameters
        ----------
        values
            Parameters, shape (parameters,) or (sets, parameters).
        taps
            Whitening filters, shape (taps,) or (sets, taps).

        Returns
        -------
        Array of shape (runs, scored), or (sets, runs, scored).
        """
        spectra = self.residual_spectra(np.atleast_2d(values))
        if taps is not None:
            spectra *= self.filter_response(np.atleast_2d(taps))[:, None]
        residual = self.samples_of(spectra.reshape(*values.shape[:-1], *spectra.shape[1:]))
        return self.without_nuisance(residual)

    def residual_spectra(self, values: FloatArray) -> ComplexArray:
        """Transforms of the residual, shape (sets, runs, bins).

        The same numbers as those of `row_spectra`, without derivatives.

        Parameters
        ----------
        values
            Parameter sets, shape (sets, parameters).
        """
        parts = self.parts(self.model.moving_responses(self.s, values))
        for c, fine in self.fine.items():
            what = values[:, self.model.changing_indices[c]]
            parts[c] = parts[c] * fine.modulated(self.window, what)[0]
        return np.asarray(self.control_spectrum - reduce(np.add, parts))

    def parts(self, responses: Sequence[Response]) -> list[ComplexArray]:
        """What each channel adds to the prediction by its response, shape (sets, runs, bins).

        Parameters
        ----------
        responses
            Per channel, that of its dynamics that have parameters, shape (sets, bins).
        """
        return [r[:, None] * signal for r, signal in zip(responses, self.inputs, strict=True)]

    def with_noticeable_terms(
        self, values: FloatArray, taps: FloatArray | None = None
    ) -> Prediction:
        """With the nuisance terms that the residual of a parameter set shows, whitened if need be.

        Fitting a term that is not there costs more than its degree of freedom: in a closed
        loop it biases the low-frequency parameters, since what is subtracted depends on
        the future of the recording (the same effect biases autoregressive coefficients
        when a mean is removed; Kendall 1954).  A term stays if its squared t-values, all
        runs together, exceed what chance gives once in a hundred.  The least noticeable goes first,
        since decays that are alike hide one another.  Those of the estimate's own slow poles
        always stay: left out, they bias what moves the pole by many claimed errors long before
        they are noticeable.
        """
        prediction = self.with_decays(values)
        slow = prediction.nuisance_poles[len(self.nuisance_poles) :]
        # What decays very slowly is much like an offset.
        always = slow if self.outlasting_lag(values) <= self.pre_history else (0.0, *slow)
        poles, terms = list(prediction.nuisance_poles), prediction.nuisance_terms
        residual = replace(self, nuisance_poles=()).errors(values, taps)
        limit = chi_squared_limit(prediction.runs, ESTIMATE.noticeable)
        while poles:
            weights = np.linalg.pinv(terms)  # two decays may be alike
            amplitudes = residual @ weights.T
            left = residual - amplitudes @ terms.T
            variance = np.sum(left**2) / (left.size - amplitudes.size)
            squares = np.sum(amplitudes**2 / np.sum(weights**2, axis=1), axis=0) / variance
            squares[np.isin(poles, always)] = np.inf
            least = int(np.argmin(squares))
            if squares[least] > limit:
                break
            del poles[least]
            terms = np.delete(terms, least, axis=1)
        return replace(self, nuisance_poles=tuple(poles))

    def row_spectra(self, values: FloatArray, between: int = 0) -> ComplexArray:
        """Transforms of the prediction's Jacobian, and below it of the residual u - u_hat.

        Parameters
        ----------
        values
            Parameter sets, shape (sets, parameters).
        between
            Number of empty rows between Jacobian and residual, for other parameters.

        Returns
        -------
        ComplexArray
            Shape (sets, parameters + between + 1, runs, bins).
        """
        model, (sets, count) = self.model, values.shape
        rows = count + between + 1
        spectrum = np.zeros((sets, rows, *self.control_spectrum.shape), dtype=complex)
        evaluated = model.evaluated(self.s, values)
        parts = self.parts(model.responses_of(evaluated))
        for c, fine in self.fine.items():
            indices = model.changing_indices[c]
            signal, slopes = fine.modulated(self.window, values[:, indices])
            spectrum[:, indices] += slopes * parts[c][:, None]
            parts[c] = parts[c] * signal
        spectrum[:, -1] = reduce(np.subtract, parts, self.control_spectrum)
        for index, slope, total in self.slopes(evaluated, parts):
            spectrum[:, index] += (slope[:, None] if slope.ndim > 1 else slope) * total
        return spectrum

    def slopes(
        self, evaluated: Sequence[Evaluated], parts: Sequence[ComplexArray]
    ) -> Iterator[tuple[int, Response, ComplexArray]]:
        """Each log-derivative of the dynamics: its parameter, itself, and what it multiplies.

        What channels share, as the neuromuscular system, has its slopes by the sum of their parts.

        Parameters
        ----------
        evaluated
            As of `PilotModel.evaluated`.
        parts
            What each channel adds, or products of that.
        """
        for (_, slopes), (_, indices), channels in zip(
            evaluated, self.model.moving, self.model.sharing, strict=True
        ):
            total = reduce(np.add, [parts[c] for c in channels])
            for index, slope in zip(indices, slopes, strict=True):
                yield index, slope, total

    @cached_property
    def inputs(self) -> list[ComplexArray]:
        """Per channel, `spectra` behind the dynamics that no parameter moves, of that shape."""
        fixed = self.model.fixed_responses(self.s)
        return [response * spectrum for response, spectrum in zip(fixed, self.spectra, strict=True)]

    def weighted_rows(self, rows: FloatArray) -> FloatArray:
        """Rows (..., runs, scored) as numbers whose products are the likelihood's, (..., m)."""
        if self.band_terms is not None and self.weights is None:
            rows = self.band_terms.weighted(rows)
        return rows.reshape(*rows.shape[:-2], -1)

    def mixed(self, weights: FloatArray) -> Prediction:
        """The prediction of weighted sums of runs: a linear pilot answers to them as to runs.

        Parameters
        ----------
        weights
            Shape (sums, runs).
        """
        return replace(
            self,
            spectra=tuple(
                spectrum[: len(weights)] if c in self.fine else weights @ spectrum
                for c, spectrum in enumerate(self.spectra)
            ),
            control_spectrum=weights @ self.control_spectrum,
            fine={c: replace(f, signals=weights @ f.signals) for c, f in self.fine.items()},
        )

    @property
    def is_large(self) -> bool:
        """Whether a search is faster by the adjoint, see `pilotid.likelihood.likelihood`."""
        # From so many bins of all runs but one the adjoint takes less time.
        return (self.runs - 1) * self.s.size >= 2500 and not self.model.changes

    @cached_property
    def binned(self) -> Prediction:
        """The prediction at few frequencies, see `binned_below`."""
        return self.binned_below(math.inf)

    def binned_below(self, band: float) -> Prediction:
        """The prediction at few frequencies, without the mean and what the window makes of it.

        A group of bins becomes a factor of its summed cross-spectra, of as many rows as there are
        signals: sums of squares over the group are kept, responses are those where its power is.

        One whose inputs vary in time has no such form: of its runs the two sums of largest power
        are left, which hold what the forcing functions do in all of them.

        Parameters
        ----------
        band
            Frequencies from this one on are left out [rad/s], unless inputs vary in time.
        """
        if self.model.changes:
            _, sums = np.linalg.eigh(self.control @ self.control.T)
            return self.mixed(sums[:, -2:].T) if self.runs > 2 else self
        scored = self.window.scored
        window = np.sqrt(8.0 / 3.0) * np.sin(np.pi * (np.arange(scored) + 0.5) / scored) ** 2
        given = np.array([*self.spectra, self.control_spectrum])
        signals = np.fft.rfft(self.samples_of(given) * window)
        omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(scored, self.dt), dtype=float)
        groups = [2 + begin for begin in group_begins(omega[2:], 1.0 / 15.0, MAX_BINNED_WIDTH)]
        sizes = np.sqrt(np.mean(np.abs(signals) ** 2, axis=(1, 2)))
        sizes[sizes == 0.0] = 1.0
        signals = signals / sizes[:, None, None]
        products = np.einsum("irk,jrk->kij", signals, signals.conj())
        summed = np.add.reduceat(products, groups, axis=0)
        size, vectors = np.linalg.eigh(summed)
        factor = vectors * np.sqrt(np.maximum(size, 0.0))[:, None, :]
        spectra = np.transpose(factor, (1, 2, 0)) * sizes[:, None, None]  # (signal, part, group)
        power = np.einsum("irk,irk->k", signals, signals.conj()).real + 1e-300
        middle = np.asarray(
            np.add.reduceat(omega * power, groups) / np.add.reduceat(power, groups), dtype=float
        )
        # Parseval: bins stand for two, but for the one at half the sampling rate.
        weights, terms = np.full(len(groups), np.sqrt(2.0 / scored)), self.band_terms
        if self.weighting is not None:
            weights *= np.sqrt(self.weighting.weights(middle))
        used = (weights > 0.0) & (middle < band)
        return replace(
            self,
            s=1j * middle[used],
            spectra=tuple(spectra[:-1, :, used]),
            control_spectrum=spectra[-1][:, used],
            nuisance_poles=(),
            weights=weights[used],
            counted=self.runs * scored if terms is None else terms.residuals,
        )

    def filter_response(self, taps: FloatArray) -> ComplexArray:
        """Response of moving-average filters at the bins, shape (..., bins)."""
        count = taps.shape[-1]
        # Taps are real: so are the products, of real and imaginary parts side by side.
        flat = taps.reshape(-1, count) @ self.shifts(count).view(float)
        return np.asarray(flat.view(complex).reshape(*taps.shape[:-1], self.s.size))

    def shifts(self, count: int) -> ComplexArray:
        """Responses of delays by 0 to `count` - 1 samples at the bins, shape (count, bins)."""
        reach = REACH if count <= REACH + 1 else FAR  # all take memory
        if reach not in self._shifts:
            powers = np.ones((reach + 1, self.s.size), dtype=complex)
            powers[1:] = np.exp(-self.s * self.dt)
            self._shifts[reach] = np.asarray(np.cumprod(powers, axis=0), dtype=complex)
        return self._shifts[reach][:count]

    @cached_property
    def _shifts(self) -> dict[int, ComplexArray]:
        """Responses that are known, by the longest delay in samples."""
        return {}

    @property
    def nuisance_terms(self) -> FloatArray:
        """The nuisance terms, shape (scored, terms).

        Exponentials are eigenfunctions of filters: whitening only scales them, so that
        the space to project out is the same for every whitening filter.
        """
        return np.exp(np.outer(np.arange(self.window.scored) * self.dt, self.nuisance_poles))

    @cached_property
    def nuisance_basis(self) -> FloatArray:
        """Orthonormal basis of the nuisance terms, shape (scored, terms)."""
        return np.asarray(np.linalg.qr(self.nuisance_terms).Q)

    def without_nuisance(self, rows: FloatArray) -> FloatArray:
        """Rows (..., scored) less their projection on the nuisance terms."""
        if not self.nuisance_poles:
            return rows
        flat = rows.reshape(-1, rows.shape[-1])  # one product, not one for each parameter
        along = (flat @ self.nuisance_basis) @ self.nuisance_basis.T
        return np.asarray(np.subtract(flat, along, out=along).reshape(rows.shape))

    def samples_before(self, spectrum: ComplexArray, most: int) -> FloatArray:
        """The scored samples of transforms and `most` samples before, (..., most + scored)."""
        signal, first = np.fft.irfft(spectrum, n=self.window.length), self.window.first
        if first < most:  # a transform has no beginning: what is before it is its end
            signal, first = np.concatenate([signal[..., -most:], signal], axis=-1), first + most
        return signal[..., first - most : first + self.window.scored]

    def samples_of(self, spectrum: ComplexArray) -> FloatArray:
        """The scored samples of transforms, (..., scored); of few frequencies, real numbers."""
        if self.weights is not None:
            return np.ascontiguousarray(spectrum * self.weights).view(float)
        return self.samples_before(spectrum, 0)


def predict(
    recording: Recording, model: PilotModel, band: float | None = None, *, fast: bool = False
) -> Prediction:
    """Prepare the prediction of a recording's control in an analysis band [rad/s].

    Parameters
    ----------
    recording
        The recording; all its runs are predicted.
    model
        The pilot model.
    band
        What lies above this frequency [rad/s] is not used; None for the full sampling rate.
    fast
        Whether the window may end a little earlier, see `window_of`; else it has whole periods.
    """
    window = window_of(recording, model, band, fast=fast)
    dt, first = window.band.dt, window.first * window.band.factor - window.before
    fine = {c: fine_input(recording, model.channels[c], window) for c in model.changing_indices}
    spectra = tuple(
        np.ones((recording.runs, window.length // 2 + 1), dtype=complex)
        if channel.changing
        else channel.sign * window.transformed(recording.input(channel.on), channel.derivative)
        for channel in model.channels
    )
    return Prediction(
        model=model,
        window=window,
        s=np.asarray(1j * window.step * np.arange(window.length // 2 + 1), dtype=complex),
        spectra=spectra,
        control_spectrum=window.transformed(recording.u),
        time=recording.time[0] + first * recording.dt + np.arange(window.scored) * dt,
        pre_history=first * recording.dt,
        nuisance_poles=(0.0, *model.fixed_poles),
        fine=fine,
    )
