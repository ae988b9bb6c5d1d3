"""
A pilot who changes
===================

Half-way through the run the controlled element becomes harder to fly, from 90/(s(s+6)) to
30/(s(s+0.2)), and the pilot adapts: less gain, more lead (the simulations of Zaal, *Journal of
Guidance, Control, and Dynamics* 39(5), 2016).  Four ways to follow him: a model that says that
there is one change along a sigmoid (``adapting``), one that lets gain and lead go along smooth
curves (``adapting-free``), windows that slide over the recording, and an unscented Kalman filter.
"""

import matplotlib.pyplot as plt
import numpy as np

import pilotid
from pilotid.show.style import journal_style

scenario = pilotid.SCENARIOS["adapting-slow"]
recording = pilotid.simulate(scenario, 2)
FITS = {
    "mle, adapting": pilotid.identify("mle", recording, "adapting"),
    "mle, adapting-free": pilotid.identify("mle", recording, "adapting-free"),
    "mle-windowed": pilotid.identify("mle-windowed", recording, "adapting"),
    "ukf": pilotid.identify("ukf", recording, "adapting"),
}

# %%
# An estimate's ``trajectory`` has the parameters of the constant pilot of each time, with a 95 %
# band.  How far each is off on average, in per cent of the truth, and how long the band holds it:

for name, estimate in FITS.items():
    course = estimate.trajectory
    true = scenario.model.over_time(scenario.values, course.time)
    for key in ("Kvis", "tlead"):
        row = course.keys.index(key)
        known = np.isfinite(course.values[row])
        error = 100.0 * (course.values[row] / true[row] - 1.0)[known]
        held = (course.lower[row] <= true[row]) & (true[row] <= course.upper[row])
        print(
            f"{name:20s} {key:6s} rms error {np.sqrt(np.mean(error**2)):5.1f} %, "
            f"in the band {100.0 * held[known].mean():3.0f} % of the time"
        )

# %%
# One recording is one recording: which way is better on average is a question for a study.

UNITS = {"Kvis": "-", "tlead": "s"}
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#AA4499")
with journal_style():
    figure, axes = plt.subplots(
        2, 4, figsize=(7.6, 3.7), layout="constrained", sharex=True, sharey="row"
    )
    for (name, estimate), column, colour in zip(FITS.items(), axes.T, COLOURS, strict=True):
        course = estimate.trajectory
        true = scenario.model.over_time(scenario.values, course.time)
        for key, panel in zip(("Kvis", "tlead"), column, strict=True):
            row = course.keys.index(key)
            panel.fill_between(
                course.time,
                course.lower[row],
                course.upper[row],
                color=colour,
                alpha=0.2,
                linewidth=0.0,
                label="95 % band",
            )
            panel.plot(course.time, course.values[row], color=colour, label="estimate")
            panel.plot(course.time, true[row], "k--", linewidth=0.9, label="truth")
        column[0].set_title(name, loc="left")
        column[1].set_xlabel("time [s]")
    for key, panel in zip(("Kvis", "tlead"), axes[:, 0], strict=True):
        panel.set_ylabel(f"{key} [{UNITS[key]}]")
    axes[0, 0].set_ylim(0.0, 0.15)
    axes[1, 0].set_ylim(0.0, 3.0)
    axes[0, 0].legend(frameon=False, loc="lower left")
plt.show()
