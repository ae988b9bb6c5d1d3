"""
Whitened residuals and their tests
==================================

What a model leaves of the control is the remnant, and a remnant is not white.  Filtered by the
inverse of its own spectrum it becomes the prediction error, which must be white and must not follow
from what the pilot saw before.  A pilot in motion, fitted with the right model and with one that
leaves out motion.
"""

import matplotlib.pyplot as plt

import pilotid
from pilotid import plot
from pilotid.show.style import journal_style
from pilotid.time_domain.diagnostics import portmanteau, prediction_errors

LAGS = 40
recording = pilotid.simulate("nominal", 5)
right = pilotid.identify("mle", recording, "multi")
wrong = pilotid.identify("mle", recording, "single")

for estimate in (right, wrong):
    own = prediction_errors(recording, estimate)
    statistic = portmanteau(own.errors, LAGS)
    print(
        f"{estimate.model.name}: VAF {estimate.vaf:.1f} %, "
        f"Ljung-Box over {LAGS} lags {statistic:.0f} ({LAGS} expected)"
    )
    print(*(f"    {remark}" for remark in estimate.remarks), sep="\n")

# %%
# Autocorrelation, correlation with error and output, and a normal plot.  Dashed lines hold 95 % of
# the correlations of white errors.  Before lag zero (shaded) the inputs follow the errors through
# the loop, and correlation is no fault.

with journal_style():
    figure, axes = plt.subplots(2, 2, figsize=(7.6, 4.6), layout="constrained")
    plot.autocorrelation(recording, right, wrong, axes=axes[0, 0])
    plot.cross_correlation(recording, right, wrong, signal="e", axes=axes[0, 1])
    plot.remnant(right, wrong, recording=recording, axes=axes[1, 0])
    plot.normal_plot(recording, right, wrong, axes=axes[1, 1])
    for panel, letter in zip(axes.flat, "abcd", strict=True):
        panel.set_title(f"({letter})", loc="left")
plt.show()
