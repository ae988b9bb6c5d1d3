"""
Posterior and profile of a parameter that is weakly known
=========================================================

Gain and lead time of one run lie in a long, bent valley: their product is known well, each alone is
not.  The interval of value plus or minus 1.96 standard errors knows nothing of the bend.  The
profile-likelihood interval of ``mle`` and the posterior of ``bayes`` follow it.
"""

import matplotlib.pyplot as plt
import numpy as np

import pilotid
from pilotid.show.style import colour_of, journal_style, log_ticks

scenario = pilotid.SCENARIOS["nominal"]
recording = pilotid.simulate(scenario, 4)
mle = pilotid.identify("mle", recording, "multi")
bayes = pilotid.identify("bayes", recording, "multi")
for key in ("Kvis", "tlead", "Kvis*tlead"):
    for estimate in (mle, bayes):
        found = estimate[key]
        low, high = found.interval
        print(
            f"{key:10s} {estimate.method:6s} {found.value:.3f}, "
            f"95 % interval {low:.3f} to {high:.3f}"
        )

# %%
# The draws of the posterior, resampled so that all have the same weight:

draws = bayes.draws.thinned(2000)
place = {key: bayes.draws.keys.index(key) for key in ("Kvis", "tlead")}
gain, lead = draws[:, place["Kvis"]], draws[:, place["tlead"]]
truth = dict(zip(scenario.model.keys, scenario.truth, strict=True))
BLUE, VIOLET, GREY = colour_of("mle"), colour_of("bayes"), "#888888"

with journal_style():
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(7.6, 3.2), layout="constrained", width_ratios=(1.0, 1.15)
    )
    left.plot(
        gain, lead, ".", color=VIOLET, markersize=1.5, alpha=0.35, label="draws of the posterior"
    )
    grid = np.geomspace(gain.min(), gain.max(), 100)
    left.plot(
        grid, mle["Kvis*tlead"].value / grid, color=GREY, linewidth=0.9, label="Kvis tlead constant"
    )
    left.plot(mle["Kvis"].value, mle["tlead"].value, "^", color=BLUE, label="mle")
    left.plot(truth["Kvis"], truth["tlead"], "k+", markersize=10.0, label="truth")
    left.set_xscale("log")
    left.set_yscale("log")
    log_ticks(left, "x")
    log_ticks(left, "y")
    left.set_xlabel("Kvis [-]")
    left.set_ylabel("tlead [s]")
    left.legend(frameon=False)

    counts, _, _ = right.hist(lead, bins=60, color=VIOLET, alpha=0.3, density=True)
    top = counts.max()
    own = mle["tlead"]
    reach = 1.96 * own.std_error
    rows = (
        ("posterior", bayes["tlead"].interval, bayes["tlead"].value, VIOLET, "<"),
        ("profile likelihood", own.interval, own.value, BLUE, "^"),
        ("value ± 1.96 std. errors", (own.value - reach, own.value + reach), own.value, GREY, "o"),
    )
    for number, (name, (low, high), value, colour, marker) in enumerate(rows):
        height = top * (1.1 + 0.12 * number)
        right.plot([low, high], [height] * 2, color=colour, linewidth=2.0)
        right.plot(
            value, height, marker, color=colour, markersize=5.0, markeredgecolor="white", label=name
        )
    right.axvline(truth["tlead"], color="black", linestyle="--", linewidth=0.8, label="truth")
    right.set_xlabel("tlead [s]")
    right.set_ylabel("posterior density [1/s]")
    right.legend(frameon=False, loc="center right")
plt.show()
