"""What a processor cannot do faster: the unit in which times are stored.

The unit is one Gram matrix of the paper's pilot in the paper's window: the inverse transforms of
its Jacobian and residual, and their inner products, at the rates that numpy's own FFT and matrix
product reach here when they do nothing else.  Divided by it, times of different machines can be
set side by side.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cache

import numpy as np

#: Jacobian of seven parameters, and the residual.
ROWS = 8
#: Bins of the transform and scored samples, in the analysis band of `nominal`.
BINS, SAMPLES = 811, 1353


@cache
def unit() -> float:
    """Seconds of one Gram matrix at the rates of FFT and matrix product."""
    return transforms(ROWS, BINS) + products(ROWS, SAMPLES)


def transforms(rows: int, bins: int) -> float:
    """Seconds of the inverse transforms of that many rows."""
    spectrum = np.ones((rows, bins), dtype=complex)
    return best(lambda: np.fft.irfft(spectrum))


def products(rows: int, samples: int) -> float:
    """Seconds of the inner products of that many rows."""
    block = np.ones((rows, samples))
    return best(lambda: block @ block.T)


def best(work: Callable[[], object], rounds: int = 30, times: int = 50) -> float:
    """The shortest of several means: what disturbs a computer makes it slower, never faster."""
    found = []
    for _ in range(rounds):
        begin = time.perf_counter()
        for _ in range(times):
            work()
        found.append((time.perf_counter() - begin) / times)
    return min(found)
