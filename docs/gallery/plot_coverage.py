"""
Coverage over a small population
================================

An interval says that it holds the truth in 95 % of all cases.  Whether it does is not a question
for one pilot: ``population-usual`` draws pilot, controlled element, forcing functions, remnant,
length and runs at random for every recording.  Errors are then told in units of what the fit
claims.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.special import erfc

import pilotid
from pilotid.show.style import colour_of, journal_style, marker_of
from pilotid.study.scores import coverage
from pilotid.support.numbers import draw_rng

METHODS = ("mle-white", "mle", "fourier")
RECORDINGS = 20
GROUPS = {
    "gains": ("Kvis", "Kvest", "Km"),
    "leads, lags": ("tlead", "tlag"),
    "delays": ("tdvis", "tdvest", "tdm"),
    "neuromuscular": ("fnm", "dnm"),
}

population = pilotid.POPULATIONS["population-usual"]
found = {method: [] for method in METHODS}  # recording, group, z, whether the interval holds
failures = dict.fromkeys(METHODS, 0)
for seed in range(RECORDINGS):
    scenario = population.drawn(draw_rng(seed, population.name))  # the pilot of that seed
    recording = pilotid.simulate(population, seed)
    for method in METHODS:
        fit = pilotid.identify(method, recording, scenario.model)
        if not fit.outcome.usable:
            failures[method] += 1
            continue
        for quantity, true in zip(fit.parameters, scenario.values, strict=True):
            group = next(name for name, keys in GROUPS.items() if quantity.key in keys)
            low, high = quantity.interval
            z = (quantity.value - true) / quantity.std_error
            found[method].append((seed, group, z, low <= true <= high))
print("failed, or not applicable:", failures)

# %%
# Parameters of one recording depend on one another, so that the Monte Carlo error is that of
# clusters, one a recording.

with journal_style():
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(7.6, 3.2), layout="constrained", width_ratios=(1.3, 1.0)
    )
    places = np.arange(len(GROUPS) + 1)
    for number, method in enumerate(METHODS):
        rows = found[method]
        colour, marker = colour_of(method), marker_of(method)
        for place, group in zip(places, (*GROUPS, "all"), strict=True):
            own = [row for row in rows if group in (row[1], "all")]
            share, (low, high), _ = coverage(
                np.array([r[3] for r in own]), np.array([r[0] for r in own])
            )
            below, above = max(0.0, share.value - low), max(0.0, high - share.value)
            left.errorbar(
                place + 0.2 * (number - 1),
                share.value,
                [[below], [above]],
                fmt=marker,
                color=colour,
                markersize=4.5,
                label=method if group == "all" else None,
            )
            if group == "all":
                print(
                    f"{method}: {share.value:.3f}, known to {share.error:.3f}, {len(own)} intervals"
                )
        z = np.sort(np.abs([row[2] for row in rows]))
        right.step(z, 1.0 - np.arange(z.size) / z.size, where="post", color=colour, label=method)
    left.axhline(0.95, color="#333333", linewidth=0.6)
    left.set_xticks(places, [*GROUPS, "all"])
    left.set_ylim(0.0, 1.02)
    left.set_ylabel("intervals that hold the truth [-]")
    left.legend(frameon=False, loc="center")

    grid = np.linspace(0.0, 8.0, 200)
    right.plot(grid, erfc(grid / np.sqrt(2.0)), "k--", linewidth=0.9, label="normal")
    right.set_yscale("log")
    right.set_ylim(3e-3, 1.0)
    right.set_xlim(0.0, 8.0)
    right.set_xlabel("|error| over claimed error [-]")
    right.set_ylabel("share beyond [-]")
    right.legend(frameon=False)
plt.show()
