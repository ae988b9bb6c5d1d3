"""
Loop margins and how far to trust them
======================================

Crossover frequency and phase margin follow from the pilot's parameters and the controlled element,
and so do their errors.  To first order they come from the covariance of ``mle``; the draws of
``bayes`` give the whole distribution.  Gain and lead time, each known to a quarter only, do no harm
here: the loop depends on their product.
"""

import matplotlib.pyplot as plt
import numpy as np

import pilotid
from pilotid import plot
from pilotid.estimates.loops import loops_of
from pilotid.pilot.loops import margins
from pilotid.show.style import colour_of, journal_style

scenario = pilotid.SCENARIOS["nominal"]
recording = pilotid.simulate(scenario, 6)
mle = pilotid.identify("mle", recording, scenario.model)
bayes = pilotid.identify("bayes", recording, scenario.model)
for estimate in (mle, bayes):
    for quantity in loops_of(estimate, scenario.element).quantities:
        low, high = quantity.interval
        print(
            f"{estimate.method:5s} {quantity.key:25s} {quantity.value:6.2f} {quantity.unit}, "
            f"95 % interval {low:.2f} to {high:.2f}"
        )
for name in ("Kvis", "tlead"):
    print(f"{name}: {mle[name].value:.2f} with a standard error of {mle[name].std_error:.2f}")

# %%
# Each draw of the posterior is a pilot, and has margins of its own.

draws = bayes.draws.thinned(600)[:, : len(scenario.model.keys)]
drawn = np.array(
    [
        [
            (loop.crossover, loop.phase_margin)
            for loop in margins(scenario.model, values, scenario.element)
        ]
        for values in draws
    ]
)
truth = margins(scenario.model, scenario.values, scenario.element)
first_order = loops_of(mle, scenario.element)

with journal_style():
    figure = plt.figure(figsize=(7.6, 4.0), layout="constrained")
    axes = figure.subplot_mosaic(
        [["magnitude", "target"], ["phase", "disturbance"]], width_ratios=(1.2, 1)
    )
    plot.open_loop(mle, scenario.element, axes=(axes["magnitude"], axes["phase"]))
    for i, loop in enumerate((first_order.target, first_order.disturbance)):
        panel = axes[loop.name]
        values = drawn[:, i, 1]
        panel.hist(
            values, bins=40, density=True, color=colour_of("bayes"), alpha=0.3, label="posterior"
        )
        own = loop.phase_margin
        grid = own.value + own.std_error * np.linspace(-4.0, 4.0, 200)
        normal = np.exp(-0.5 * ((grid - own.value) / own.std_error) ** 2)
        panel.plot(
            grid,
            normal / (own.std_error * np.sqrt(2.0 * np.pi)),
            color=colour_of("mle"),
            label="mle, first order",
        )
        panel.axvline(
            truth[i].phase_margin, color="black", linestyle="--", linewidth=0.8, label="truth"
        )
        panel.set_title(f"{loop.name} loop", loc="left")
        panel.set_xlabel("phase margin [deg]")
        panel.set_ylabel("density [1/deg]")
    axes["target"].legend(frameon=False)
plt.show()
