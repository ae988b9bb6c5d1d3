"""Derivatives of recorded signals in the frequency domain, free of what was before and after.

Let x and v obey a linear differential equation.  Multiplied by phi = w e^{-jwt}, with a window w
that vanishes at both ends along with its first derivatives, and integrated by parts, every
derivative moves from the signal to phi, and no value at either end is left (Shinbrot, *On the
Analysis of Linear and Nonlinear Systems*, Trans. ASME 79, 1957: the method of modulating
functions).  So there is neither leakage nor an initial state to estimate, whether the signals
are periodic or not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pilotid.types import ComplexArray, FloatArray, IntArray

#: The window sin^4(pi t/T) as a sum of cosines cos(2 pi k t/T): its derivatives up to the third
#: vanish at the ends, enough for equations of order 4.
COSINES = (3.0 / 8.0, -1.0 / 2.0, 1.0 / 8.0)
HIGHEST = 4  # derivative of the output
TAYLOR = 3  # order to which the window is expanded for a delay
#: Of so many bins one is used: those between are nearly their sum.
EACH = 2
#: Independent observations per bin used: the window makes neighbours alike,
#: (mean of w^2)^2 / mean of w^4 for each bin.
INDEPENDENT = EACH * (35.0 / 128.0) ** 2 / (6435.0 / 32768.0)
#: A constant offset reaches the bins below.
FIRST = len(COSINES)


def windowed(signal: FloatArray, dt: float, order: int, bins: IntArray) -> ComplexArray:
    """Fourier integrals of a signal times the derivatives of the window.

    Parameters
    ----------
    signal
        Shape (runs, samples).
    dt
        Sampling interval [s].
    order
        Highest derivative of the window.
    bins
        Multiples of 2 pi / T that are wanted, from `FIRST` on.

    Returns
    -------
    Array of shape (order + 1, runs, bins).
    """
    samples = signal.shape[1]
    spectrum = np.fft.fft(signal, axis=1) * dt
    result = np.zeros((order + 1, len(signal), bins.size), dtype=complex)
    for k, size in enumerate(COSINES):
        rate = 2.0 * np.pi * k / (samples * dt)
        for sign in (1, -1):
            # cos = (e^+ + e^-)/2; each is a shift by k bins, and a derivative a factor of j rate.
            shifted = 0.5 * size * spectrum[:, bins - sign * k]
            for j in range(order + 1):
                result[j] += (1j * sign * rate) ** j * shifted
    return result


@dataclass(frozen=True, eq=False)
class Spectra:
    """Windowed spectra of an input v and an output x; runs and frequencies in one row.

    Attributes
    ----------
    omega
        Frequencies [rad/s], shape (n,).
    output
        Of the derivatives of x, shape (`HIGHEST` + 1, n).
    parts
        Of the derivatives of v(t - delay), by powers of the delay, but for the factor
        e^{-s delay}; shape (derivatives, `TAYLOR` + 1, n).
    each
        Bins of runs that stand behind each of the n.
    """

    omega: FloatArray
    output: ComplexArray
    parts: ComplexArray
    each: float

    @cached_property
    def s(self) -> ComplexArray:
        """Laplace variable, shape (n,)."""
        return np.asarray(1j * self.omega)

    def delayed(self, count: int, delay: float) -> ComplexArray:
        """Of the first derivatives of v(t - delay), from the zeroth on, shape (count, n)."""
        powers = np.array([delay**p / math.factorial(p) for p in range(TAYLOR + 1)])
        late = np.exp(-self.s * delay)
        return np.asarray((powers @ self.parts[:count]) * late)


def spectra_of(
    dt: float, given: FloatArray, output: FloatArray, highest: float, zeros: int
) -> Spectra:
    """Windowed spectra of a recording.

    Parameters
    ----------
    dt
        Sampling interval [s].
    given, output
        v and x, shape (runs, samples).
    highest
        Highest frequency [rad/s].
    zeros
        Highest derivative of v that is wanted.
    """
    runs, samples = output.shape
    last = min(int(highest * samples * dt / (2.0 * np.pi)), int(0.4 * samples))
    bins = np.arange(FIRST, last + 1, EACH)
    order = zeros + TAYLOR
    columns = np.concatenate(
        [windowed(output, dt, HIGHEST, bins), windowed(given, dt, order, bins)]
    )
    if runs > len(columns):
        # More runs than signals tell no more than a triangular factor does.
        triangles = np.asarray(np.linalg.qr(columns.transpose(2, 1, 0), mode="r"))
        columns = triangles.transpose(2, 1, 0)
    rows = columns.shape[1]
    columns = columns.reshape(len(columns), -1)
    omega = np.tile(2.0 * np.pi * bins / (samples * dt), rows)
    bare, delayed = columns[: HIGHEST + 1], columns[HIGHEST + 1 :]
    return Spectra(
        omega,
        np.array([_derivative(bare, i, omega) for i in range(HIGHEST + 1)]),
        np.array(
            [
                [_derivative(delayed[p:], i, omega) for p in range(TAYLOR + 1)]
                for i in range(zeros + 1)
            ]
        ),
        runs / rows,
    )


def _derivative(bare: ComplexArray, order: int, omega: FloatArray) -> ComplexArray:
    """Of a signal's derivative, from those of the signal times the window's derivatives."""
    s = 1j * omega
    terms = [
        math.comb(order, j) * (-1.0) ** j * s ** (order - j) * bare[j] for j in range(order + 1)
    ]
    return np.asarray(sum(terms))
