"""
A method of one's own in a comparison
=====================================

A method is a frozen dataclass of settings with a name, an objection and a fit.  The one here lies
in a file beside this script and is named as the command line would name it; its fits run in
processes of their own, as all fits of a study do.
"""

import tempfile

import matplotlib.pyplot as plt
import numpy as np

import pilotid
from pilotid.methods import method_named
from pilotid.show.style import colour_of, journal_style, marker_of
from pilotid.testing import check_method

# %%
# The method:
#
# .. literalinclude:: /gallery/own/smoothed.py
#    :language: python

# %%
# ``check_method`` holds it to what every method promises.  Then a study sets it beside two
# others, on the pilot in motion of AIAA 2008-7109 with a coloured and with a white remnant.

place = "own/smoothed.py:Smoothed"  # from the folder of this script
check_method(method_named(place))
methods = ("mle-white", "mle", place)
with tempfile.TemporaryDirectory() as folder:
    comparison = pilotid.compare(
        ("nominal", "white-remnant"), methods, replications=12, out=folder, workers=1
    )
for cell in comparison.cells:
    print(
        f"{cell.scenario.name}, {cell.method}: {cell.usable} of {cell.tried} fits count, "
        f"{1e3 * cell.seconds:.0f} ms each, loss {cell.scores[0].loss.value:.2f}"
    )

with journal_style():
    figure, axes = plt.subplots(
        2, 2, figsize=(7.6, 4.2), layout="constrained", sharex=True, sharey="col"
    )
    for (left, right), scenario in zip(axes, comparison.scenarios, strict=True):
        cells = comparison.of(scenario.name)
        keys = [known.parameter for known in scenario.parameters]
        places = np.arange(len(keys))
        for number, cell in enumerate(cells):
            shift = places + 0.2 * (number - 1)
            style = {
                "fmt": marker_of(cell.method),
                "color": colour_of(cell.method),
                "markersize": 4.5,
                "label": cell.method,
            }
            scores = cell.scores[1:]  # the first is of all parameters
            bias = [score.percent.bias.value for score in scores]
            reach = [1.96 * score.percent.bias.error for score in scores]
            left.errorbar(shift, bias, reach, **style)
            share = np.array([score.coverage.value for score in scores])
            ends = np.array([score.coverage_interval for score in scores])
            bars = np.maximum(0.0, [share - ends[:, 0], ends[:, 1] - share])
            right.errorbar(shift, share, bars, **style)
        left.axhline(0.0, color="#333333", linewidth=0.6)
        right.axhline(0.95, color="#333333", linewidth=0.6)
        left.set_title(scenario.name, loc="left")
        left.set_ylabel("bias [% of the truth]")
        right.set_ylabel("coverage of 95 % intervals [-]")
        left.set_xticks(places, keys)
    axes[0, 0].legend(frameon=False, loc="lower right")
plt.show()

# %%
# Bars are 95 % Monte Carlo intervals.  The method of one's own takes every bin of a tapered
# spectrum for a new piece of evidence, and a coloured remnant for a white one.
