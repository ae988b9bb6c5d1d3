"""The analysis band, and what decimation to it makes of a spectrum."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from pilotid.time_domain.prepare import decimation, lowpass
from pilotid.time_domain.whitening import FAR
from pilotid.types import FloatArray

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

    @cached_property
    def omega(self) -> FloatArray:
        """Frequencies inside the band [rad/s], shape (grid,)."""
        return np.asarray((np.arange(GRID) + 0.5) * (np.pi / (GRID * self.dt)), dtype=float)

    @cached_property
    def folds(self) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """Frequencies that decimation folds onto `omega`, and the filter's power there."""
        if self.factor == 1:
            return ((self.omega, np.ones(GRID)),)
        folded = (self.omega, 2.0 * np.pi / self.dt - self.omega)
        return tuple((w, self._filter_power(w)) for w in folded)

    def _filter_power(self, omega: FloatArray) -> FloatArray:
        taps = lowpass(self.factor)
        k = np.arange(taps.size) - taps.size // 2
        return np.asarray((np.cos(np.outer(omega * self.recorded_dt, k)) @ taps) ** 2)

    @cached_property
    def cosines(self) -> FloatArray:
        """Maps a spectrum on `omega` to autocovariances, shape (grid, FAR + 1)."""
        return np.asarray(np.cos(np.outer(self.omega * self.dt, np.arange(FAR + 1))) / GRID)

    @cached_property
    def folded(self) -> tuple[FloatArray, FloatArray]:
        """All frequencies of `folds`, and what maps a spectrum there to autocovariances."""
        omega, weights = (np.concatenate(parts) for parts in zip(*self.folds, strict=True))
        return omega, weights[:, None] * np.tile(self.cosines, (len(self.folds), 1))

    def autocovariance(self, power: FloatArray, reach: int) -> FloatArray:
        """Autocovariances up to lag `reach` of spectra (..., n) at all frequencies of `folded`."""
        return np.asarray(power @ self.folded[1][:, : reach + 1])


@lru_cache
def analysis_band(dt: float, band: float | None) -> Band:
    """The analysis band up to `band` [rad/s], or all, of a recording sampled every `dt` [s]."""
    return Band(dt, decimation(dt, band))
