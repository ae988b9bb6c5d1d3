"""
A pilot who changes
===================

Half-way through the run the controlled element becomes harder to fly, from 90/(s(s+6)) to
30/(s(s+0.2)), and the pilot adapts: less gain, more lead (the simulations of Zaal, *Journal of
Guidance, Control, and Dynamics* 39(5), 2016).  The model ``adapting`` says that there is one change
along a sigmoid.
"""

import matplotlib.pyplot as plt
import numpy as np

import pilotid
from pilotid.show.style import journal_style

scenario = pilotid.SCENARIOS["adapting-slow"]
recording = pilotid.simulate(scenario, 2)
estimate = pilotid.identify("mle", recording, "adapting")
print(estimate.summary())

# %%
# Gain and lead over time, estimated and true:


def over_time(key, values, time):
    own = dict(zip(estimate.model.keys, values, strict=True))
    share = 1.0 / (1.0 + np.exp(-own["rate"] * (time - own["tmid"])))
    return own[f"{key}1"] + (own[f"{key}2"] - own[f"{key}1"]) * share


time = np.linspace(0.0, recording.duration, 500)
with journal_style():
    figure, axes = plt.subplots(2, 1, figsize=(3.7, 3.4), layout="constrained", sharex=True)
    for (key, unit), panel in zip((("Kvis", "-"), ("tlead", "s")), axes, strict=True):
        panel.plot(time, over_time(key, estimate.values, time), color="#0072B2", label="mle")
        panel.plot(time, over_time(key, scenario.values, time), "k--", linewidth=0.9, label="truth")
        panel.set_ylabel(f"{key} [{unit}]")
    axes[0].set_ylim(0.0, 0.15)
    axes[1].set(ylim=(0.0, 3.0), xlabel="time [s]")
    axes[0].legend(frameon=False, loc="lower left")
plt.show()
