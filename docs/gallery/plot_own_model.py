"""
A model of one's own
====================

A pilot model is a sum of channels, each a product of factors.  A factor gives its response and the
derivative of its logarithm by each parameter; all else (Jacobians, starts, bounds, loops, tables)
follows.  Here a washout, T s/(1 + T s): a pilot who feels rates, but not steady ones.  He is
simulated, and fitted with the model that made him and with ``rate`` of the catalogue, which has no
washout.
"""

from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np

import pilotid
from pilotid import Channel, PilotModel, Scenario, plot
from pilotid.datasets.remnant import Remnant
from pilotid.pilot.factors import (
    Delay,
    Differentiator,
    Factor,
    Gain,
    Lead,
    Neuromuscular,
    Parameter,
)
from pilotid.show.style import journal_style


@dataclass(frozen=True)
class Washout(Factor):
    """First-order high-pass T s/(1 + T s)."""

    key: str = "twash"

    @property
    def parameters(self):
        return (Parameter(self.key, "s", lower=0.02, upper=30.0, start=1.0, usual=(0.2, 5.0)),)

    def response(self, s, values):
        return values[0] * s / (1.0 + values[0] * s)

    def rational(self, values, pade_order):
        return [float(values[0]), 0.0], [float(values[0]), 1.0]


visual = Channel(
    "visual", "error", 1, (Gain("Kvis", 0.25), Lead(), Delay("tdvis"), Neuromuscular())
)
motion = Channel(
    "motion",
    "output",
    -1,
    (Differentiator(1), Washout(), Gain("Km", 0.3), Delay("tdm", 0.2), Neuromuscular()),
)
washed = PilotModel("washed-out", (visual, motion), "visual channel, and washed-out rate feedback")
print(washed.keys)

# %%
# Two runs of him, by mle with both models.  The criterion is -2 log-likelihood up to a constant of
# the recording: the smaller, the better.

truth = {
    **{"Kvis": 0.25, "tlead": 1.2, "tdvis": 0.30},
    **{"twash": 0.5, "Km": 0.5, "tdm": 0.2, "fnm": 12.0, "dnm": 0.3},
}
scenario = Scenario(
    "washed-out",
    "a pilot who feels rates, but not steady ones",
    model=washed,
    truth=tuple(truth[key] for key in washed.keys),
    remnant=Remnant(order=1, frequency=4.0, level=0.1, level_is="ratio"),
    runs=2,
)
recording = pilotid.simulate(scenario, 1)
own = pilotid.identify("mle", recording, washed)
rate = pilotid.identify("mle", recording, "rate")
for estimate in (own, rate):
    print(estimate.summary())
    print(f"criterion {estimate.criterion:.1f}\n")

with journal_style():
    figure, axes = plt.subplots(2, 2, figsize=(7.6, 4.2), layout="constrained", sharex=True)
    for column, channel, other in zip(
        axes.T, ("visual", "motion"), rate.model.channels, strict=True
    ):
        plot.describing_function(
            own, channel=channel, truth=scenario.values, units=recording.units, axes=tuple(column)
        )
        omega = np.geomspace(*column[0].get_xlim(), 200)
        response = rate.model.response(omega, rate.values)[rate.model.channels.index(other)]
        phase = np.degrees(np.unwrap(np.angle(response)))
        column[0].plot(omega, np.abs(response), ":", color="#D55E00", label="mle, rate")
        column[1].plot(omega, phase, ":", color="#D55E00")
        column[0].legend(frameon=False)
plt.show()
