"""The pilot models by name.

Their starts are generic: round numbers in the middle of what is published, the same for a
parameter wherever it occurs with the same meaning.  None is the truth of any data set, so that
a method which returns where it starts is seen to have found nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from pilotid.model.channel import Changing, Channel
from pilotid.model.factors import (
    Canals,
    Delay,
    Differentiator,
    Factor,
    Gain,
    Inverse,
    Lag,
    Lead,
    LookAhead,
    Neuromuscular,
)
from pilotid.model.model import PilotModel
from pilotid.support.naming import named, require_name
from pilotid.support.types import InputError, reason


def _visual(*factors: Factor | Changing) -> Channel:
    """A channel on the error."""
    return Channel("visual", "error", 1, factors)


def _motion(name: str, *factors: Factor) -> Channel:
    """A channel on what motion tells a pilot of the output."""
    return Channel(name, "output", -1, factors)


def _target(name: str, *factors: Factor) -> Channel:
    """A channel on the target in view."""
    return Channel(name, "target", 1, factors)


#: Ends of most channels; its delay, and what moves the arm.
SLOW = (Delay("tdvis"), Neuromuscular())

#: A gain on the error of a double integrator, with lead.
GAIN_AND_LEAD = (Gain("Kvis", 0.25), Lead("tlead"), *SLOW)
LED = _visual(*GAIN_AND_LEAD)

#: With lead and lag, for elements between position and acceleration control.
LED_AND_LAGGED = _visual(Gain("Kvis", 0.5), Lead("tlead"), Lag("tlag", 0.25), *SLOW)

#: The same with the lead squared, for elements that lag like two integrators and more.
TWICE_LED = _visual(Gain("Kvis", 0.5), Lead("tlead"), Lead("tlead"), Lag("tlag", 0.25), *SLOW)

#: A gain and a lead that vary in time.
VARYING = (Gain("Kvis", 0.25), Lead("tlead", usual=(0.1, 5.0)))

#: The semicircular canals on the acceleration of the output.
CANALS = _motion(
    "vestibular",
    *(Differentiator(2), Canals(), Gain("Kvest", 1.0), Delay("tdvest", 0.2), Neuromuscular()),
)

#: The rate of the output.
RATE_FEEDBACK = _motion(
    "motion", Differentiator(1), Gain("Km", 0.25), Delay("tdm", 0.2), Neuromuscular()
)

#: The rate of the target in view.
FEEDFORWARD = _target(
    "target",
    *(Differentiator(1), Gain("Kt", 0.25), Lag("tlagt", 0.25), Delay("tdt", 0.2), Neuromuscular()),
)

#: How far ahead the two viewpoints of a previewed target lie; the bound keeps the near one near,
#: or else the two change places.
FAR_VIEW = LookAhead("tlookf", 0.8, usual=(0.3, 1.5))
NEAR_VIEW = LookAhead("tlookn", 0.25, bounds=(0.0, 0.6), usual=(0.05, 0.5))

_CATALOGUE = (
    PilotModel(
        "single",
        (LED,),
        "visual channel with lead, delay and neuromuscular dynamics (AIAA 2008-7109)",
    ),
    PilotModel(
        "multi",
        (LED, CANALS),
        "visual channel and semicircular-canal channel on acceleration (AIAA 2008-7109)",
    ),
    PilotModel(
        "gain",
        (_visual(Gain("Kvis", 0.5), *SLOW),),
        "visual gain, delay and neuromuscular dynamics: rate control (McRuer & Jex 1967); position "
        "control takes a lag",
    ),
    PilotModel(
        "lead-lag",
        (LED_AND_LAGGED,),
        "visual channel with lead-lag equalisation (1 + tlead s)/(1 + tlag s) (McRuer & Jex 1967)",
    ),
    PilotModel(
        "lead2-lag",
        (TWICE_LED,),
        "visual channel with (1 + tlead s)^2/(1 + tlag s) (Pool, Harder & van Paassen 2016)",
    ),
    PilotModel(
        "rate",
        (LED, RATE_FEEDBACK),
        "visual channel and rate feedback s Km e^{-tdm s} from motion",
    ),
    PilotModel(
        "lead-lag-motion",
        (LED_AND_LAGGED, RATE_FEEDBACK),
        "lead-lag visual channel and rate feedback s Km e^{-tdm s} from motion",
    ),
    PilotModel(
        "lead-lag-canals",
        (LED_AND_LAGGED, CANALS),
        "lead-lag visual channel and semicircular-canal channel on acceleration",
    ),
    PilotModel(
        "lead2-lag-motion",
        (TWICE_LED, CANALS),
        "visual channel with (1 + tlead s)^2/(1 + tlag s) and semicircular-canal channel on "
        "acceleration (Pool, Harder & van Paassen 2016)",
    ).with_start({"tdvest": 0.25}),  # .2 is next to what is published
    PilotModel(
        "crossover",
        (
            _visual(
                Gain("wc", 2.5, "rad/s", (0.05, 50.0)),
                Delay("tde", 0.3, usual=(0.1, 0.6)),
                Inverse(),
            ),
        ),
        "what makes wc e^{-tde s}/s the open loop with the controlled element, about the crossover "
        "frequency alone (McRuer & Jex 1967)",
    ),
    # The first-order lag of the neuromuscular system of the publication is left to the delay.  What
    # acts at low frequencies is bounded away from the equalisation, or they would change places.
    PilotModel(
        "precision",
        (
            _visual(
                *LED_AND_LAGGED.factors[:-2],
                Lead("tleadlow", 4.0, (1.0, 60.0), (1.0, 10.0)),
                Lag("tlaglow", 10.0, (1.0, 200.0), (3.0, 40.0)),
                *SLOW,
            ),
        ),
        "visual channel with lead-lag equalisation and (1 + tleadlow s)/(1 + tlaglow s), by which "
        "the phase drops at low frequencies (McRuer & Jex 1967)",
    ),
    PilotModel(
        "pursuit",
        (LED, FEEDFORWARD),
        "visual channel and feedforward s Kt e^{-tdt s}/(1 + tlagt s) of the target in view, an "
        "integrator inverted (Drop et al. 2013)",
    ),
    PilotModel(
        "look-ahead",
        (
            _target("target", Gain("Kt"), LookAhead(), Neuromuscular()),
            _motion("feedback", Gain("Kvis", 0.5), Lag("tlag", 0.25), *SLOW),
        ),
        "response Kt e^{+tlook s} to a target displayed ahead, and a lagged one to the output "
        "(after Yamagami et al. 2019)",
    ),
    # The error that is responded to is that of the target some time ahead, low-passed.  Two
    # viewpoints beside a compensatory response are the publication's; starts and ranges were
    # chosen here.
    PilotModel(
        "preview",
        (
            _target(
                "far",
                *(*GAIN_AND_LEAD, Gain("Kf", 1.0), Lag("tlagf", 0.3, usual=(0.1, 2.0)), FAR_VIEW),
            ),
            _motion("feedback", *GAIN_AND_LEAD),
            _target(
                "near",
                *(Differentiator(1), Gain("Kn", 0.05), Lag("tlagn", 0.1, usual=(0.02, 0.5))),
                *(NEAR_VIEW, *SLOW),
            ),
        ),
        "response Kvis (1 + tlead s) to the target tlookf ahead, low-passed, less the output, and "
        "to the rate of the target tlookn ahead (after van der El et al. 2016)",
        # Channels are linear in Kf and Kvis each, but not in both together: Kf is searched.
        (replace(Gain("Kf").parameters[0], linear=False, usual=(0.5, 1.5)),),
    ),
    PilotModel(
        "following",
        (
            _target(
                "target",
                *(Gain("Kt"), Lag("tlagt", 0.25), Delay("tdt", 0.2), Neuromuscular()),
            ),
        ),
        "target followed by hand, Kt e^{-tdt s}/(1 + tlagt s) and neuromuscular dynamics, without "
        "a displayed error (after Bonnen et al. 2015)",
    ),
    # Gain and lead pass from one value to another along one sigmoid, as where the element changes.
    PilotModel(
        "adapting",
        (_visual(Changing(VARYING), *SLOW),),
        "visual channel whose gain and lead pass from Kvis1, tlead1 to Kvis2, tlead2 along a "
        "sigmoid in time (Zaal, JGCD 39(5) 2016)",
    ),
)
#: Models by the name that the command line takes, and the name by which it chooses one.
MODELS: dict[str, PilotModel] = {model.name: model for model in _CATALOGUE}
AUTO = "auto"
SINGLE, MULTI, ADAPTING = (MODELS[name] for name in ("single", "multi", "adapting"))


def model_named(text: str) -> PilotModel:
    """The model that a text names.

    Parameters
    ----------
    text
        A name of the catalogue, or ``file.py:NAME`` or ``package.module:NAME``; with settings
        behind it, such as ``rate(name=mine)``, if there are any to change.

    Raises
    ------
    InputError
        If there is none; the message lists the names there are.
    """
    model = named(text, MODELS, "model", "NAME")
    if not isinstance(model, PilotModel):
        raise InputError(
            f"{text}: is no PilotModel; write NAME = PilotModel('name', (Channel(...), ...)) there"
        )
    require_name(model.name, "model")
    fault = fault_of(model)
    if MODELS.get(model.name, model) != model:
        fault = f"has the name '{model.name}' of another model; give it a name of its own"
    if fault:
        raise InputError(f"{text}: {fault}")
    return model


#: Frequencies [rad/s] at which a model is tried.
TRIED = np.array([0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0])


def fault_of(model: PilotModel) -> str:
    """What is wrong with the numbers that a model's factors give, empty if they are sound."""
    if not model.parameters:
        return "the model has no parameter to estimate"
    model = model.constant  # what varies in time is put together of constant factors
    try:
        with np.errstate(all="ignore"):
            response = model.response(TRIED, model.start)
    except Exception as error:  # code of others may raise anything
        return f"the model gives no response ({reason(error)})"
    if np.isfinite(response).all():
        return ""
    return (
        "the response is not finite at the start values: give an integrator a pole below zero, for "
        "example a lag of 100 s"
    )


def with_held(models: Iterable[PilotModel], text: str | None) -> list[PilotModel]:
    """Models with the parameters held, or bounded, that a text such as ``fnm=12,dnm=.1..0.5`` says.

    Raises
    ------
    InputError
        If the text cannot be read, or says something of a parameter that none of the models has.
    """
    changed = list(models)
    for pair in () if text is None else text.split(","):
        key, _, value = (part.strip() for part in pair.partition("="))
        try:
            numbers = [float(part) for part in value.split("..", 1)]
        except ValueError:
            raise InputError(
                f"--fix {text}: '{pair}' is not PARAMETER=NUMBER or PARAMETER=LOWER..UPPER; write "
                "for example fnm=12,dnm=0.1..0.5"
            ) from None
        having = [place for place, m in enumerate(changed) if key in m.index]
        if not having:
            known = ", ".join(dict.fromkeys(k for m in changed for k in m.keys))
            raise InputError(
                f"--fix {text}: no model here has a parameter {key} that is not held already; "
                f"choose from {known}"
            )
        for place in having:
            if len(numbers) == 1:
                changed[place] = changed[place].with_fixed(**{key: numbers[0]})
            else:
                changed[place] = changed[place].with_bounds(**{key: (numbers[0], numbers[1])})
    return changed
