"""Signals at another sampling rate."""

from __future__ import annotations

import numpy as np

from pilotid.support.types import FloatArray

#: Half the length of the low-pass filter, in samples of the slower rate; its pass band ends at .84
#: of half that rate, its stop band (80 dB) begins there.
REACH = 32
EDGE, KAISER = 0.92, 8.0


def resampled(signals: FloatArray, up: int, down: int) -> FloatArray:
    """Signals at up/down times their sampling rate, without aliases and without delay.

    Parameters
    ----------
    signals
        Shape (runs, samples).
    up, down
        Whole numbers without a common divisor.

    Returns
    -------
    Array of shape (runs, ceil(samples * up / down)); the first sample is at the same time.
    """
    from scipy.signal import firwin, resample_poly

    longest = max(up, down)
    low_pass = firwin(2 * REACH * longest + 1, EDGE / longest, window=("kaiser", KAISER))
    # Beyond the ends a signal goes on as its own point reflection, so that nothing jumps there.
    extra = -(-REACH * longest // (up * down)) * down
    extra = min(extra, (signals.shape[1] - 1) // down * down)
    wide = np.pad(signals, ((0, 0), (extra, extra)), mode="reflect", reflect_type="odd")
    found = resample_poly(wide, up, down, axis=1, window=low_pass)  # type: ignore[call-overload]
    # (scipy's stubs forget that a window may be an array)
    first = extra * up // down
    return np.asarray(found[:, first : first - (-signals.shape[1] * up // down)])
