"""Numbers that stand for missing values."""

from __future__ import annotations

import numpy as np

from pilotid.types import FloatArray, InputError

#: Magnitudes that instruments and programs write where they have no value; in single precision
#: they are a little off.
CODES = np.array(
    [999.0, 9999.0, 99999.0, 999999.0, 9999999.0, 32768.0, *(10.0**n for n in range(20, 38))]
)
HUGE = 1e38  # nothing that is measured is so large, but the largest numbers are so: 1e308
APART = 5.0  # times as large as anything else in the signal


def refuse_codes(values: FloatArray, name: str, source: str) -> None:
    """Refuse a signal in which a number stands for missing values.

    Parameters
    ----------
    values
        A signal, shape (runs, samples).
    name, source
        What it is, for messages.

    Raises
    ------
    InputError
        If its largest magnitude is such a code, far from all else in the signal.
    """
    size = np.abs(values)
    largest = float(size.max(initial=0.0))
    if largest < HUGE and not np.isclose(CODES, largest, rtol=1e-6, atol=0.0).any():
        return
    there = size == largest
    if APART * float(size[~there].max(initial=0.0)) >= largest or there.all():
        return
    run, sample = (int(i) for i in np.argwhere(there)[0])
    count = int(np.count_nonzero(there))
    raise InputError(
        f"{source}: signal {name} is {values[run, sample]:g} at {count} "
        f"sample{'s' if count > 1 else ''}, the first of them sample {sample + 1} of run "
        f"{run + 1}: a code for missing values; repair or cut the recording there"
    )
