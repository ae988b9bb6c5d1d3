"""The pilot models by name.

Their starts are generic: round numbers in the middle of what is published, the same for a
parameter wherever it occurs with the same meaning.  None is the truth of any data set, so that
a method which returns where it starts is seen to have found nothing.
"""

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

#: A gain on the error of a double integrator, with lead.
VISUAL: tuple[Factor, ...] = (Gain("Kvis", 0.25), Lead("tlead"), Delay("tdvis"), Neuromuscular())


SINGLE = PilotModel(
    "single",
    (Channel("visual", "error", 1, VISUAL),),
    "visual channel with lead, delay and neuromuscular dynamics (AIAA 2008-7109)",
)


MULTI = PilotModel(
    "multi",
    (
        Channel("visual", "error", 1, VISUAL),
        Channel(
            "vestibular",
            "output",
            -1,
            (
                Differentiator(2),
                Canals(),
                Gain("Kvest", 1.0),
                Delay("tdvest", 0.2),
                Neuromuscular(),
            ),
        ),
    ),
    "visual channel and semicircular-canal channel on acceleration (AIAA 2008-7109)",
)


GAIN_ONLY = PilotModel(
    "gain",
    (Channel("visual", "error", 1, (Gain("Kvis", 0.5), Delay("tdvis"), Neuromuscular())),),
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
                Lead("tlead"),
                Lag("tlag", 0.25),
                Delay("tdvis"),
                Neuromuscular(),
            ),
        ),
    ),
    "visual channel with lead-lag equalisation (1 + tlead s)/(1 + tlag s)",
)


RATE = PilotModel(
    "rate",
    (
        Channel("visual", "error", 1, VISUAL),
        Channel(
            "motion",
            "output",
            -1,
            (
                Differentiator(1),
                Gain("Km", 0.25),
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
