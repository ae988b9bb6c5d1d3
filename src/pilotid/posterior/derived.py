"""Functions of the parameters, with the spread that the posterior gives them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pilotid.estimates.draws import Draws, Spread, spread_of
from pilotid.estimates.loops import CHANGES, COUNT, SampledLoop, sampled_loops
from pilotid.estimates.quantities import product_spreads
from pilotid.pilot.element import ControlledElement
from pilotid.pilot.model import PilotModel
from pilotid.recordings.recording import Recording
from pilotid.time_domain.fast_residuals import Residuals
from pilotid.time_domain.prediction import predict
from pilotid.types import FloatArray

BLOCK = 8  # parameter sets simulated at once


def parameter_spreads(draws: Draws, model: PilotModel) -> list[Spread]:
    """The sampled parameters, the remnant's last."""
    units = {p.key: p.unit for p in model.parameters} | {"frequency": "rad/s"}
    return [
        spread_of(
            key,
            units.get(key, ""),
            draws.values[:, i],
            draws.weights,
            effective=float(draws.effective[i]),
            r_hat=float(draws.r_hat[i]),
        )
        for i, key in enumerate(draws.keys)
    ]


def derived_spreads(
    draws: Draws,
    model: PilotModel,
    recording: Recording,
    element: ControlledElement | None,
) -> list[Spread]:
    """The product of gain and lead time, the VAF, and loop margins if the element is known."""
    result = product_spreads(draws)
    some = draws.equally_weighted(COUNT)[:, : len(model.parameters)]
    result.append(spread_of("VAF", "%", vafs(recording, model, some)))
    if element is not None and not model.changes:
        result += _margin_spreads(draws, model, element)
    return result


def vafs(recording: Recording, model: PilotModel, values: FloatArray) -> FloatArray:
    """Variance accounted for [%] by each parameter set, see `simulated_vaf`, shape (sets,)."""
    prediction = predict(recording, model)
    residuals = Residuals(prediction)
    spread = np.mean(np.var(prediction.control, axis=1))
    left = np.empty(len(values))
    for begin in range(0, len(values), BLOCK):
        block = slice(begin, begin + BLOCK)
        samples = prediction.samples_of(residuals.spectra(values[block]))
        left[block] = np.mean(np.var(prediction.without_nuisance(samples), axis=2), axis=1)
    return np.asarray(np.maximum(0.0, 100.0 * (1.0 - left / spread)))


def _margin_spreads(
    draws: Draws, model: PilotModel, element: ControlledElement
) -> Sequence[Spread]:
    spreads = []
    for loop in _sampled(draws, model, element):
        spreads += [
            spread_of(f"{loop.loop.name} {what}", unit, values)
            for what, unit, values in (
                ("crossover", "rad/s", loop.crossover),
                ("phase margin", "deg", loop.phase_margin),
            )
            if values.size
        ]
    return spreads


def loop_notes(draws: Draws, model: PilotModel, element: ControlledElement) -> list[str]:
    """What should be known of the loops' margins over draws, a sentence each."""
    if model.changes:
        return [CHANGES]
    return [note for loop in _sampled(draws, model, element) for note in loop.loop.notes]


def _sampled(draws: Draws, model: PilotModel, element: ControlledElement) -> list[SampledLoop]:
    count = len(model.parameters)
    sets = draws.equally_weighted(COUNT)[:, :count]
    return sampled_loops(model, draws.centre[:count], sets, element)
