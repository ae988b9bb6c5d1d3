"""
Bias over the colour of the remnant
===================================

A residual that is taken for white makes biased estimates where the remnant is coloured: in a closed
loop error and output carry the remnant, and a model of the pilot can predict part of it from them.
A long recording does not help.  Here the pilot in motion of AIAA 2008-7109 has a remnant of 15 % of
the control's power, and only its break frequency differs, up to white noise.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import pilotid
from pilotid.bounds import white_limit
from pilotid.datasets.experiments import experiment_of
from pilotid.datasets.remnant import Remnant, white
from pilotid.show.style import colour_of, journal_style, marker_of

METHODS = ("mle-white", "mle", "fourier", "arx")
KEYS = ("tdvis", "Kvest", "tdvest", "fnm")
FREQUENCIES = (2.0, 4.0, 8.0, 16.0)  # rad/s
WHITE = 40.0  # where white is drawn
RECORDINGS = 8

nominal = pilotid.SCENARIOS["nominal"]


def with_remnant(frequency):
    """The nominal scenario with another remnant."""
    if frequency == WHITE:
        return replace(nominal, name="white", remnant=white(0.15))
    remnant = Remnant(order=2, frequency=frequency, level=0.15, level_is="ratio")
    return replace(nominal, name=f"low-pass-{frequency:g}", remnant=remnant)


# %%
# Every method fits the same recordings.  A fit that failed has no values and counts as such.

columns = [nominal.model.keys.index(key) for key in KEYS]
truth = nominal.values[columns]
errors = {}
failures = dict.fromkeys(METHODS, 0)
for frequency in (*FREQUENCIES, WHITE):
    scenario = with_remnant(frequency)
    recordings = [pilotid.simulate(scenario, seed) for seed in range(RECORDINGS)]
    for method in METHODS:
        fits = [pilotid.identify(method, recording, "multi") for recording in recordings]
        kept = [fit.values[columns] for fit in fits if fit.outcome.usable]
        failures[method] += len(fits) - len(kept)
        errors[method, frequency] = 100.0 * (np.array(kept) / truth - 1.0)
print("failed fits:", failures)

# %%
# What output error with a white residual tends to in a long recording follows from the spectra of
# the loop, without simulation.

theory_at = np.geomspace(FREQUENCIES[0], FREQUENCIES[-1], 9)
theory = np.array(
    [100.0 * white_limit(experiment_of(with_remnant(f))).bias / nominal.values for f in theory_at]
)[:, columns]

with journal_style():
    figure, axes = plt.subplots(1, 4, figsize=(7.6, 2.7), layout="constrained", sharex=True)
    for i, (panel, key) in enumerate(zip(axes, KEYS, strict=True)):
        panel.axhline(0.0, color="#333333", linewidth=0.6)
        panel.plot(
            theory_at,
            theory[:, i],
            color=colour_of("mle-white"),
            linewidth=1.0,
            label="white residual, theory",
        )
        for number, method in enumerate(METHODS):
            places = np.array([*FREQUENCIES, WHITE]) * 1.09 ** (number - 1.5)
            own = [errors[method, f][:, i] for f in (*FREQUENCIES, WHITE)]
            bias = [e.mean() for e in own]
            reach = [1.96 * e.std(ddof=1) / np.sqrt(e.size) for e in own]
            panel.errorbar(
                places,
                bias,
                reach,
                fmt=marker_of(method),
                color=colour_of(method),
                markersize=4.0,
                linewidth=1.0,
                label=method,
            )
        panel.set_xscale("log")
        panel.set_xticks([*FREQUENCIES, WHITE], ["2", "4", "8", "16", "white"])
        panel.minorticks_off()
        panel.set_title(key, loc="left")
    axes[0].set_ylabel("bias [% of the true value]")
    figure.supxlabel("break frequency of the remnant [rad/s]", fontsize=8.0)
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=5, frameon=False
    )
plt.show()

# %%
# Bars are 95 % intervals of the mean over the recordings.  The white residual is right where the
# remnant is white, and off elsewhere as theory says; the other methods need no white remnant.
