"""The pilot models by name."""

from __future__ import annotations

from pilotid.pilot.factors import (
    Canals,
    Delay,
    Differentiator,
    Factor,
    Gain,
    Lag,
    Lead,
    Neuromuscular,
)
from pilotid.pilot.model import Channel, PilotModel
from pilotid.types import InputError


def _visual(gain: float, lead: float, delay: float) -> tuple[Factor, ...]:
    return (
        Gain("Kvis", gain),
        Lead("tlead", lead),
        Delay("tdvis", delay),
        Neuromuscular(),
    )


SINGLE = PilotModel(
    "single",
    (Channel("visual", "error", 1, _visual(0.32, 1.68, 0.39)),),
    "visual channel with lead, delay and neuromuscular dynamics (AIAA 2008-7109)",
)


MULTI = PilotModel(
    "multi",
    (
        Channel("visual", "error", 1, _visual(0.17, 2.93, 0.32)),
        Channel(
            "vestibular",
            "output",
            -1,
            (
                Differentiator(2),
                Canals(),
                Gain("Kvest", 1.59),
                Delay("tdvest", 0.29),
                Neuromuscular(),
            ),
        ),
    ),
    "visual channel and semicircular-canal channel on acceleration (AIAA 2008-7109)",
)


GAIN_ONLY = PilotModel(
    "gain",
    (Channel("visual", "error", 1, (Gain("Kvis", 0.5), Delay("tdvis", 0.3), Neuromuscular())),),
    "visual gain, delay and neuromuscular dynamics (position and rate control)",
)


LEAD_LAG = PilotModel(
    "lead-lag",
    (
        Channel(
            "visual",
            "error",
            1,
            (
                Gain("Kvis", 0.5),
                Lead("tlead", 0.8),
                Lag("tlag", 0.3),
                Delay("tdvis", 0.3),
                Neuromuscular(),
            ),
        ),
    ),
    "visual channel with lead-lag equalisation (1 + tlead s)/(1 + tlag s)",
)


RATE = PilotModel(
    "rate",
    (
        Channel("visual", "error", 1, _visual(0.3, 1.0, 0.3)),
        Channel(
            "motion",
            "output",
            -1,
            (
                Differentiator(1),
                Gain("Km", 0.3),
                Delay("tdm", 0.2),
                Neuromuscular(),
            ),
        ),
    ),
    "visual channel and rate feedback s Km e^{-tdm s} from motion",
)


#: Models by the name that the command line takes.
MODELS: dict[str, PilotModel] = {m.name: m for m in (SINGLE, MULTI, GAIN_ONLY, LEAD_LAG, RATE)}


def model_named(name: str) -> PilotModel:
    """The catalogue's model of that name; `InputError` lists the names there are."""
    if name not in MODELS:
        raise InputError(f"unknown model '{name}': choose from {', '.join(MODELS)}")
    return MODELS[name]
