"""
How many runs
=============

A run of 82 s knows the delays to a per cent and gain and lead to a quarter.  Runs of one
condition, fitted together, know more.  Left, the scatter of ``mle`` over recordings of one, two
and five runs beside the bound; right, how likely a paired t test finds a lead time that differs
by 15 % between two conditions, over the number of subjects.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import pilotid
from pilotid.datasets.experiments import experiment_of
from pilotid.designing.planning import plan
from pilotid.show.style import journal_style, log_ticks
from pilotid.theory.bounds import bounds

KEYS = ("Kvis", "tlead", "Kvest", "tdvis")
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
RUNS = (1, 2, 5)
RECORDINGS = 20

scenario = pilotid.SCENARIOS["nominal"]
columns = [scenario.model.keys.index(key) for key in KEYS]
logarithms, bound = [], []
for runs in RUNS:
    several = replace(scenario, name=f"{runs}-runs", runs=runs)
    fits = [
        pilotid.identify("mle", pilotid.simulate(several, seed), several.model)
        for seed in range(RECORDINGS)
    ]
    kept = np.array([fit.values[columns] for fit in fits if fit.outcome.usable])
    print(f"{runs} runs: {len(kept)} of {len(fits)} fits count")
    logarithms.append(np.log(kept))
    covariance = bounds(experiment_of(several)).low_pass
    bound.append(100.0 * np.sqrt(np.diag(covariance))[columns] / scenario.values[columns])

# %%
# The scatter is that of the logarithm of the estimates, to first order the relative error: gain and
# lead are skewed where they are known to a quarter only.

planned = plan(scenario, "tlead", 0.15)
subjects = np.arange(2, 31)

with journal_style():
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.6, 3.1), layout="constrained")
    for i, (key, colour) in enumerate(zip(KEYS, COLOURS, strict=True)):
        scatter = np.array([100.0 * own[:, i].std(ddof=1) for own in logarithms])
        error = [
            1.96 * s / np.sqrt(2.0 * (len(own) - 1))
            for s, own in zip(scatter, logarithms, strict=True)
        ]
        left.plot(RUNS, [own[i] for own in bound], color=colour)
        left.errorbar(
            np.array(RUNS) * 1.04 ** (i - 1.5),
            scatter,
            error,
            fmt="o",
            color=colour,
            markersize=3.5,
            markerfacecolor="white",
            label=key,
        )
    left.plot([], [], color="#333333", label="bound")
    left.set_xscale("log")
    left.set_yscale("log")
    left.set_xticks(RUNS, [str(runs) for runs in RUNS])
    left.minorticks_off()
    log_ticks(left, "y")
    left.set_xlabel("runs fitted together [-]")
    left.set_ylabel("scatter of the estimates [%]")
    left.legend(frameon=False, ncols=2)
    for runs, colour in zip((1, 2, 5), COLOURS, strict=False):
        chances = [planned.chance(int(n), runs) for n in subjects]
        right.plot(
            subjects, chances, ".-", color=colour, label=f"{runs} run{'s' if runs > 1 else ''} each"
        )
    right.axhline(0.8, color="#333333", linewidth=0.6)
    right.set_ylim(0.0, 1.0)
    right.set_xlabel("subjects [-]")
    right.set_ylabel("chance to find the difference [-]")
    right.set_title("tlead 15 % longer in the other condition", loc="left")
    right.legend(frameon=False)
for runs in (1, 2, 5):
    print(f"{runs} runs in each condition: {planned.subjects(runs)} subjects for a chance of .8")
plt.show()

# %%
# Bars are 95 % Monte Carlo intervals.  The plan takes the spreads of
# ``pilotid.designing.planning``: 5 % of the value from run to run, 10 % between subjects.
