"""Residuals of very many parameter sets: what a sampler evaluates, without Jacobians."""

from __future__ import annotations

from collections import Counter
from functools import reduce
from operator import and_

import numpy as np

from pilotid.pilot.delayed import Delayed
from pilotid.pilot.factors import OnAxis, Response, TimeDelay
from pilotid.pilot.model import Placed
from pilotid.time_domain.prediction import Prediction
from pilotid.types import ComplexArray, FloatArray

CACHED = 6000  # bins evaluated at once: about what the processor's cache holds


class _Layout:
    """Factors with their parameters, sorted once by how they are evaluated."""

    def __init__(self, placed: list[Placed]) -> None:
        self.delays = [(f, own) for f, own in placed if isinstance(f, TimeDelay)]
        rest = [(f, own) for f, own in placed if not isinstance(f, TimeDelay)]
        self.on_axis = [(f, own) for f, own in rest if isinstance(f, OnAxis)]
        self.others = [(f, own) for f, own in rest if not isinstance(f, OnAxis)]


class Residuals:
    """Transforms of the residual u - u_hat, before whitening, for many parameter sets.

    The same numbers as those of `Prediction.row_spectra`, several times faster: constant
    factors enter once and for all, factors that all channels share are applied to their
    sum, and the exponentials of a delay, whose phase grows evenly from bin to bin, are
    products of two short rows.

    Parameters
    ----------
    prediction
        The prepared prediction.
    """

    def __init__(self, prediction: Prediction) -> None:
        self.prediction = prediction
        model = prediction.model
        shared = reduce(and_, (Counter(p for p in layout if p[1]) for layout in model.layout))
        self._common = _Layout(list(shared.elements())) if shared else None
        self._channels: list[tuple[_Layout, ComplexArray]] = []
        for layout, spectrum in zip(model.layout, prediction.inputs, strict=True):
            moving = list((Counter(p for p in layout if p[1]) - shared).elements())
            self._channels.append((_Layout(moving), spectrum[None]))
        #: Per channel, the linear parameters that it depends on: place among those, and index.
        self._scaling = [
            [(i, index) for i, index in enumerate(model.linear) if any(index in p for _, p in own)]
            for own in model.layout
        ]
        self._omega = prediction.s.imag
        self._delayed = Delayed(self._omega)

    def linear_gram(self, values: FloatArray) -> FloatArray:
        """Inner products of the derivatives by linear parameters, and of the residual.

        All that it takes to solve for gains; nuisance terms are projected out.  Of models that
        do not vary in time.

        Parameters
        ----------
        values
            Parameter sets, shape (sets, parameters).

        Returns
        -------
        Array of shape (sets, linear + 1, linear + 1), the residual last.
        """
        prediction, channels = self.prediction, len(self._channels)
        control = prediction.without_nuisance(prediction.control).ravel()
        # Of each channel's answer and of the control.
        products = np.empty((len(values), channels + 1, channels + 1))
        products[:, -1, -1] = control @ control
        block = max(1, CACHED // prediction.control_spectrum.size)
        for begin in range(0, len(values), block):
            own = values[begin : begin + block]
            rows = np.empty((len(own), channels, *prediction.control_spectrum.shape), dtype=complex)
            common = None if self._common is None else self._product(self._common, own)
            for row, (layout, spectrum) in enumerate(self._channels):
                part = self._product(layout, own)
                if common is not None:
                    part = part * common
                np.multiply(part[:, None, :], spectrum, out=rows[:, row])
            answers = prediction.without_nuisance(prediction.samples_of(rows))
            flat = answers.reshape(*answers.shape[:2], -1)
            found = products[begin : begin + block]
            found[:, :-1, :-1] = flat @ flat.transpose(0, 2, 1)
            found[:, -1, :-1] = found[:, :-1, -1] = flat @ control
        linear = prediction.model.linear
        combined = np.zeros((len(values), len(linear) + 1, channels + 1))
        combined[:, -1, :-1], combined[:, -1, -1] = -1.0, 1.0
        for channel, scaling in enumerate(self._scaling):
            for place, index in scaling:
                combined[:, place, channel] = 1.0 / values[:, index]
        return np.asarray(combined @ products @ combined.transpose(0, 2, 1))

    def spectra(self, values: FloatArray) -> ComplexArray:
        """Transforms of the residuals, shape (sets, runs, bins).

        Parameters
        ----------
        values
            Parameter sets, shape (sets, parameters).
        """
        total: ComplexArray | None = None
        given = self.prediction.varying(values)
        for (layout, spectrum), varying in zip(self._channels, given, strict=True):
            part = self._product(layout, values)[:, None, :] * spectrum
            if varying is not None:
                part = part * varying
            total = part if total is None else np.add(total, part, out=total)
        assert total is not None
        if self._common is not None:
            total *= self._product(self._common, values)[:, None, :]
        return np.subtract(self.prediction.control_spectrum, total, out=total)

    def _product(self, layout: _Layout, values: FloatArray) -> ComplexArray:
        """Product of factors, shape (sets, bins) or, without any that varies, (sets, 1)."""
        gain = np.ones((len(values), 1))
        responses: list[Response] = []
        for axial, indices in layout.on_axis:
            own = [values[:, i, None] for i in indices]
            responses.append(axial.response_on_axis(self._omega, own))
        for factor, indices in layout.others:
            response = factor.response(self.prediction.s, [values[:, i, None] for i in indices])
            if response.shape[-1] == 1:
                gain = gain * np.real(response)
            else:
                responses.append(response)
        if layout.delays:
            delays = [f.seconds([values[:, i, None] for i in own]) for f, own in layout.delays]
            responses.append(self._delayed(sum(delays[1:], delays[0]), gain))
        elif responses:
            responses[0] = responses[0] * gain
        else:
            return gain.astype(complex)
        result = responses[0]
        for response in responses[1:]:
            result = result * response
        return np.asarray(result, dtype=complex)
