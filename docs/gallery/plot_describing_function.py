"""
Describing functions with error bars
====================================

``fourier`` needs no model of the pilot for its first step: at each line of the forcing functions it
gives the response of each channel, with an error.  ``mle`` gives a model, and a band.  They share
nothing but the recording, here one of five runs, so that each checks the other.
"""

import matplotlib.pyplot as plt
import numpy as np

import pilotid
from pilotid import plot
from pilotid.show.style import journal_style

scenario = pilotid.SCENARIOS["runs-5"]
recording = pilotid.simulate(scenario, 3)
mle = pilotid.identify("mle", recording, "multi")
fourier = pilotid.identify("fourier", recording, "multi")
points = fourier.frequency_response

with journal_style():
    figure, axes = plt.subplots(2, 2, figsize=(7.6, 4.4), layout="constrained", sharex=True)
    for column, channel in zip(axes.T, scenario.model.channels, strict=True):
        plot.describing_function(
            mle,
            channel=channel.name,
            truth=scenario.values,
            points=points,
            units=recording.units,
            axes=tuple(column),
        )
plt.show()

# %%
# Bars and bands are 95 % intervals; a phase whose error is too large to be drawn is left out.  Are
# the errors of the responses honest?  About 95 % of them should hold the truth.

exact = scenario.model.response(points.omega, scenario.values)
off = np.abs(points.value - exact)
for channel, own, std in zip(scenario.model.channels, off, points.std, strict=True):
    # A complex error whose real and imaginary parts scatter alike is within 1.73 times its root
    # mean square with probability .95.
    held = int(np.sum(own < np.sqrt(-np.log(0.05)) * std))
    print(f"{channel.name}: {held} of {own.size} responses hold the truth")
