"""
The price of a forcing function
===============================

What does precision cost the pilot?  ``pilotid.design`` finds the powers of the lines that make the
errors small within limits on the variances of error and control.  Left, the errors that are
predicted for the best target and disturbance if error and control may be as large as with those of
AIAA 2008-7109, and more; right, what the number of lines does, under the paper's own limits.
Nothing is simulated here: errors are Cramér-Rao bounds of one run, 81.92 s long.
"""

import matplotlib.pyplot as plt

import pilotid
from pilotid.designing.design import design
from pilotid.designing.limits import Limits
from pilotid.designing.lines import chosen_lines, reference_lines
from pilotid.show.style import journal_style, log_ticks

scenario = pilotid.SCENARIOS["nominal"]
KEYS = scenario.model.keys
MARKERS = "o^sDvPX"
COLOURS = ("#0072B2", "#56B4E9", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#332288")

allowed = (1.0, 1.25, 1.5, 2.0, 3.0)
by_limit = [pilotid.design(scenario, limit=f"e={limit},u={limit}") for limit in allowed]
for limit, made in zip(allowed, by_limit, strict=True):
    lead, delay = 100.0 * made.errors["tlead"], 100.0 * made.errors["tdvis"]
    print(
        f"e and u up to {limit:g} times: tlead to {lead:.1f} %, tdvis to {delay:.2f} %, "
        f"at most {100.0 * made.gap:.1g} % from the optimum"
    )

# %%
# The marks beside 1 are the errors with the forcing functions of the paper.  Other numbers of
# lines, spread evenly on a logarithmic scale over the same band:

counts = (4, 6, 8, 12, 16, 24)
by_count = [
    design(
        scenario, limits=Limits(e=1.0, u=1.0), lines=chosen_lines(reference_lines(scenario), count)
    )
    for count in counts
]

with journal_style():
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(7.6, 3.2), layout="constrained", sharey=True
    )
    for key, marker, colour in zip(KEYS, MARKERS, COLOURS, strict=True):
        style = {"color": colour, "marker": marker, "markersize": 6.0 if key == "Kvis" else 4.0}
        errors = [100.0 * made.errors[key] for made in by_limit]
        left.plot([made.costs["e"] for made in by_limit], errors, label=key, **style)
        right.plot(counts, [100.0 * made.errors[key] for made in by_count], **style)
        paper = 100.0 * by_limit[0].reference_errors[key]
        left.plot(0.95, paper, marker, color="#333333", markersize=4.0, markerfacecolor="white")
    left.plot(
        [],
        [],
        "o",
        color="#333333",
        markersize=4.0,
        markerfacecolor="white",
        label="forcing functions\nof the paper",
    )
    left.set_yscale("log")
    log_ticks(left, "y")
    left.set_xlabel("variance of the error, over the paper's [-]")
    left.set_ylabel("standard error of one run [%]")
    left.set_title("more error and control", loc="left")
    right.set_xlabel("lines of target and of disturbance [-]")
    right.set_title("more lines", loc="left")
    right.set_xticks(counts)
    figure.legend(loc="outside right center", frameon=False)
plt.show()
