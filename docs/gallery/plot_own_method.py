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
whole = comparison.scores[comparison.scores.parameter == "all"]
print(whole[["scenario", "method", "usable", "recordings", "seconds", "loss"]].to_string())

with journal_style():
    figure, axes = plt.subplots(
        2, 2, figsize=(7.6, 4.2), layout="constrained", sharex=True, sharey="col"
    )
    for (left, right), scenario in zip(axes, comparison.scenarios, strict=True):
        for number, method in enumerate(comparison.methods):
            scores = comparison.scored(scenario, method)[1:]  # the first is of all parameters
            keys = list(scores.parameter)
            places = np.arange(len(keys))
            shift = places + 0.2 * (number - 1)
            style = {
                "fmt": marker_of(method),
                "color": colour_of(method),
                "markersize": 4.5,
                "label": method,
            }
            scale = 100.0 / scores.truth.abs()
            left.errorbar(shift, scores.bias_percent, 1.96 * scale * scores.bias_se, **style)
            share = scores.coverage_95
            bars = [share - scores.coverage_lower, scores.coverage_upper - share]
            right.errorbar(shift, share, np.maximum(0.0, bars), **style)
        left.axhline(0.0, color="#333333", linewidth=0.6)
        right.axhline(0.95, color="#333333", linewidth=0.6)
        left.set_title(scenario, loc="left")
        left.set_ylabel("bias [% of the truth]")
        right.set_ylabel("coverage of 95 % intervals [-]")
        left.set_xticks(places, keys)
    axes[0, 0].legend(frameon=False, loc="lower right")
plt.show()

# %%
# Bars are 95 % Monte Carlo intervals.  The method of one's own takes every bin of a tapered
# spectrum for a new piece of evidence, and a coloured remnant for a white one.
