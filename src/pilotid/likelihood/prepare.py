"""Preparation of a recording for prediction: the transforms of its signals in an analysis band.

All signals are continued beyond their ends, faded to zero, pass through one linear-phase low-pass
filter, and are decimated to the band, all of it in their transforms.  A filter common to all
signals commutes with a linear time-invariant pilot, so that the model is as true of the prepared
signals as of the recorded ones.  Derivatives of an input, which motion channels act on, are
products of its transform and s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording
from pilotid.support.types import ComplexArray, FloatArray, InputError


def padded(signal: FloatArray, before: int, length: int, extension: int) -> FloatArray:
    """A signal continued beyond both ends, faded to zero, shape (runs, length).

    Odd reflection, since a jump would ring into the scored part, where whitening magnifies it.

    Parameters
    ----------
    signal
        The signal, shape (runs, samples).
    before, length
        Samples before it, and of the whole.
    extension
        Samples over which it fades out.
    """
    fade = 0.5 * (1.0 + np.cos(np.pi * np.arange(1, extension + 1) / (extension + 1)))
    longer = np.pad(signal, ((0, 0), (extension, extension)), "reflect", reflect_type="odd")
    longer[:, :extension] *= fade[::-1]
    longer[:, -extension:] *= fade
    zeros = before - extension, length - before - signal.shape[1] - extension
    return np.pad(longer, ((0, 0), zeros))


#: Samples that a whitening filter may reach back, and that one may to whom low frequencies matter.
REACH, FAR = 20, 60


def prediction_error_filters(autocovariance: FloatArray) -> FloatArray:
    """Prediction-error filters by Levinson's and Durbin's recursion, shape (sets, lags).

    Parameters
    ----------
    autocovariance
        Lags from 0, shape (sets, lags).
    """
    sets, lags = autocovariance.shape
    taps = np.zeros((sets, lags))
    taps[:, 0] = 1.0
    power = autocovariance[:, 0].copy()
    for order in range(1, lags):
        across = np.einsum("sk,sk->s", taps[:, :order], autocovariance[:, order:0:-1])
        reflection = -across / power
        taps[:, 1 : order + 1] += reflection[:, None] * taps[:, order - 1 :: -1][:, :order]
        power = power * (1.0 - reflection * reflection)
    return taps


MIN_SCORED = 3.0  # seconds that must remain to be scored
#: Shares of half the sampling rate of a band between which its low-pass filter falls from 1 to 0,
#: and samples at the end into which it mixes what lies beyond the recording.
FALLS, MIXED = (0.825, 1.175), 8


def decimation(dt: float, band: float | None) -> int:
    """Largest whole factor that keeps the band below half the new sampling rate."""
    return 1 if band is None else max(1, math.floor(math.pi / (band * dt) + 1e-9))


GRID = 256  # frequencies on which spectra of noise models are integrated


@dataclass(frozen=True)
class Band:
    """The analysis band: sampling interval of a recording, and factor of decimation."""

    recorded_dt: float
    factor: int

    @property
    def dt(self) -> float:
        """Sampling interval after decimation [s]."""
        return self.recorded_dt * self.factor

    @property
    def limit(self) -> float | None:
        """The band as `predict` takes it [rad/s]; None for the full sampling rate."""
        return None if self.factor == 1 else math.pi / self.dt

    @cached_property
    def omega(self) -> FloatArray:
        """Frequencies inside the band [rad/s], shape (grid,)."""
        return np.asarray((np.arange(GRID) + 0.5) * (np.pi / (GRID * self.dt)), dtype=float)

    @cached_property
    def cosines(self) -> FloatArray:
        """Maps a spectrum on `omega` to autocovariances, shape (grid, FAR + 1)."""
        return np.asarray(np.cos(np.outer(self.omega * self.dt, np.arange(FAR + 1))) / GRID)

    def lowpass(self, omega: FloatArray) -> FloatArray:
        """Response of the filter that signals pass before they are decimated [rad/s]."""
        share = np.interp(omega * self.dt / np.pi, FALLS, (0.0, 1.0))
        return np.asarray(0.5 + 0.5 * np.cos(np.pi * share))

    @cached_property
    def folded(self) -> tuple[FloatArray, FloatArray]:
        """Frequencies that decimation folds into the band, and what maps spectra there.

        It maps to autocovariances behind the low-pass filter.
        """
        if self.factor == 1:
            return self.omega, self.cosines
        omega = np.concatenate([self.omega, 2.0 * np.pi / self.dt - self.omega])
        return omega, self.lowpass(omega)[:, None] ** 2 * np.tile(self.cosines, (2, 1))

    def autocovariance(self, power: FloatArray, reach: int) -> FloatArray:
        """Autocovariances up to lag `reach` of spectra (..., n) at all frequencies of `folded`."""
        return np.asarray(power @ self.folded[1][:, : reach + 1])


#: A `Band`, made once for all recordings: its cosines take half a millisecond.
shared_band = lru_cache(Band)


@dataclass(frozen=True)
class Window:
    """Where a recording lies among the samples of an analysis band.

    Attributes
    ----------
    band
        The band.
    before, extension
        Samples before the recording, and those of them over which signals fade out, as recorded.
    length
        Length of transforms, in samples of the band.
    first, scored
        Index of the first scored sample, and how many there are, in samples of the band.
    """

    band: Band
    before: int
    extension: int
    length: int
    first: int
    scored: int

    def spectrum(self, signal: FloatArray, ratio: int, order: int = 0) -> ComplexArray:
        """Transform of a recorded signal, of `ratio` samples for each of the band, (runs, bins).

        What it has above half that sampling rate is left out.

        Parameters
        ----------
        signal
            The signal, shape (runs, samples).
        ratio
            At most the band's factor.
        order
            Order of the derivative that is meant.
        """
        if order:  # a mean has none, and would make one as it fades
            signal = signal - signal.mean(axis=1, keepdims=True)
        whole = padded(signal, self.before, self.length * self.band.factor, self.extension)
        bins = self.length * ratio // 2 + 1
        spectrum = np.fft.rfft(whole)[:, :bins] * (ratio / self.band.factor)
        return spectrum * (1j * self.step * np.arange(bins)) ** order if order else spectrum

    def decimated(self, spectrum: ComplexArray, ratio: int) -> ComplexArray:
        """Transform in the band, shape (..., bins), of that of `ratio` samples for each."""
        if ratio == 1:
            return spectrum
        bins = self.length // 2 + 1
        passed = spectrum[..., :bins] * self._gain[:bins] / ratio
        folded = math.floor(0.5 * FALLS[0] * self.length)  # bins from here on
        above = slice(self.length - bins + 1, self.length - folded + 1)
        passed[..., folded:] += (spectrum[..., above] * self._gain[above] / ratio)[..., ::-1].conj()
        return passed

    @cached_property
    def _gain(self) -> FloatArray:
        """Response of the low-pass filter at twice as many bins as there are in the band."""
        return self.band.lowpass(self.step * np.arange(self.length + 1.0))

    def transformed(self, signal: FloatArray, order: int = 0) -> ComplexArray:
        """Transform of a recorded signal, or of a derivative, in the band, shape (runs, bins)."""
        ratio = min(2, self.band.factor)
        return self.decimated(self.spectrum(signal, ratio, order), ratio)

    @property
    def step(self) -> float:
        """Distance of the bins of transforms [rad/s]."""
        return 2.0 * math.pi / (self.length * self.band.dt)


def window_of(
    recording: Recording, model: PilotModel, band: float | None, *, fast: bool = False
) -> Window:
    """The window of a recording that is scored in an analysis band.

    Parameters
    ----------
    recording
        The recording.
    model
        As many samples are not scored at the end as it looks ahead.
    band
        Analysis band [rad/s]; None keeps the full sampling rate.
    fast
        Whether a few of the last samples are left out (at most 4 % of 300, 2.5 % of 500 or more),
        so that transforms of the window are fast: large prime factors make them slow.
    """
    from scipy.fft import next_fast_len, prev_fast_len  # when it is needed

    factor, total = decimation(recording.dt, band), recording.u.shape[1]
    first = max(recording.run_in, round(recording.lead_in / recording.dt))
    unseen = round(model.ahead / recording.dt) + (MIXED * factor if factor > 1 else 0)
    if total - 1 - first - unseen < MIN_SCORED / recording.dt:
        raise InputError(
            f"{recording.source}: {total * recording.dt:.3g} s of recording leave less than "
            f"{MIN_SCORED:g} s to score in the analysis band; "
            "use a longer recording or a wider band"
        )
    scored = (total - 1 - first - unseen) // factor + 1
    if fast and band is not None:
        scored = prev_fast_len(scored)
    extension = min(round(4.0 / recording.dt), total - 1)
    before = extension + -(extension + first) % factor
    length = next_fast_len(math.ceil((before + total + extension) / factor), real=True)
    within = shared_band(recording.dt, factor)
    return Window(within, before, extension, length, (before + first) // factor, scored)
