"""
Every model in one picture each
===============================

Describing functions of the catalogue's models, channel by channel, at their generic starts.  A
channel's sign is that with which it adds to the control: motion and feedback act against the
output.  The table of :doc:`/guide/models` has their parameters.
"""

import textwrap

import matplotlib.pyplot as plt
import numpy as np

import pilotid
from pilotid.pilot.element import double_integrator
from pilotid.show.style import journal_style, log_ticks

OMEGA = np.geomspace(0.1, 30.0, 300)
DASHES = ("-", "--", ":")
COLOURS = {"e": "#0072B2", "x": "#D55E00", "ft": "#009E73"}


def picture(model, sets):
    """Magnitude and phase of each channel, for one set of parameters or several."""
    with journal_style():
        figure, axes = plt.subplots(1, 2, figsize=(7.6, 2.4), layout="constrained")
        for values, note, width in sets:
            for channel, response, dash in zip(
                model.channels, model.response(OMEGA, values), DASHES, strict=False
            ):
                style = {"color": COLOURS[channel.on], "linestyle": dash, "lw": width}
                label = f"{channel.name} (on {channel.on}){note}"
                axes[0].loglog(OMEGA, np.abs(response), label=label, **style)
                phase = np.unwrap(np.angle(channel.sign * response), period=2.0 * np.pi)
                axes[1].semilogx(OMEGA, np.degrees(phase), **style)
        axes[0].set_ylabel("magnitude")
        axes[1].set_ylabel("phase [deg]")
        for own in axes:
            own.set_xlabel("frequency [rad/s]")
            log_ticks(own, "x")
        log_ticks(axes[0], "y")
        axes[0].legend(frameon=False, loc="best")
        words = "\n".join(textwrap.wrap(model.description, 110))
        figure.suptitle(f"{model.name}: {words}", fontsize="medium", x=0.01, ha="left")


def starts(model):
    """A set of parameters, or two where the pilot passes from one to the other."""
    if model.name != "adapting":
        return [(model.constant.start, "", 1.2)]
    before, after = (model.start[i] for i in model.ends)
    after = after * np.where(np.isin(model.constant.keys, ["tlead"]), 3.0, 1.0)
    return [(before, ", before", 0.8), (after, ", after", 1.6)]


for model in pilotid.MODELS.values():
    known = model.with_element(double_integrator(4.0))
    picture(known.constant, starts(known))
    print(f"{model.name}: {', '.join(model.keys)}")
plt.show()

# %%
# ``crossover`` is made for a controlled element, here 4/s²: the pilot is the inverse of the element
# and an integrator, and the open loop crosses over at ``wc`` with the delay ``tde``.  ``adapting``
# is ``single`` at any one time; its lead is three times as long afterwards here.
