"""
What motion does to a pilot
===========================

Without motion a pilot of a double integrator lives on visual lead, late and with little margin.  In
motion the semicircular canals tell him of accelerations.  AIAA 2008-7109 gives both pilots; here
each is simulated, identified, and its loops are closed on paper: the target loop (how the pilot
follows) and the disturbance loop (how he rejects what pushes the aircraft).
"""

import matplotlib.pyplot as plt
import numpy as np

import pilotid
from pilotid.estimates.loops import loops_of
from pilotid.pilot.loops import margins, open_loops
from pilotid.show.style import colour_of, journal_style

RECORDINGS = 12
COLOURS = {"without motion": colour_of("mle-white"), "in motion": colour_of("mle")}
SCENARIOS = {
    "without motion": pilotid.SCENARIOS["single"],
    "in motion": pilotid.SCENARIOS["nominal"],
}

estimates = {
    name: [
        pilotid.identify("mle", pilotid.simulate(scenario, seed), scenario.model)
        for seed in range(RECORDINGS)
    ]
    for name, scenario in SCENARIOS.items()
}
for name, fits in estimates.items():
    loops = [loops_of(fit, SCENARIOS[name].element) for fit in fits]
    print(f"{name}: {sum(fit.outcome.usable for fit in fits)} of {len(fits)} fits count")
    for which in ("target", "disturbance"):
        for what in ("crossover", "phase_margin"):
            found = [getattr(getattr(loop, which), what) for loop in loops]
            values = np.array([quantity.value for quantity in found])
            claimed = np.mean([quantity.std_error for quantity in found])
            print(
                f"  {which} {what.replace('_', ' ')}: {values.mean():.2f} {found[0].unit}, "
                f"scatter {values.std(ddof=1):.2f}, claimed {claimed:.2f}"
            )

# %%
# Left, the disturbance loop of every fit over the true one; right, crossover frequency and phase
# margin of both loops, each with its own 95 % intervals.

omega = np.geomspace(0.5, 20.0, 200)
with journal_style():
    figure = plt.figure(figsize=(7.6, 3.9), layout="constrained")
    axes = figure.subplot_mosaic(
        [["magnitude", "plane"], ["phase", "plane"]], width_ratios=(1, 1.1)
    )
    for name, fits in estimates.items():
        scenario, colour = SCENARIOS[name], COLOURS[name]
        curves = [fit.values for fit in fits if fit.outcome.usable]
        for values, width, own in [
            *((v, 0.5, colour) for v in curves),
            (scenario.values, 1.2, "black"),
        ]:
            loop = open_loops(scenario.model, values, scenario.element, omega)[1]
            phase = np.degrees(np.unwrap(np.angle(loop)))
            phase -= 360.0 * np.ceil(phase[0] / 360.0)
            dash = "-" if own == colour else "--"
            axes["magnitude"].loglog(omega, np.abs(loop), dash, color=own, linewidth=width)
            axes["phase"].semilogx(omega, phase, dash, color=own, linewidth=width)
        truth = margins(scenario.model, scenario.values, scenario.element)
        loops = [loops_of(fit, scenario.element) for fit in fits if fit.outcome.usable]
        for which, marker, true in zip(("target", "disturbance"), "os", truth, strict=True):
            x = [getattr(loop, which).crossover for loop in loops]
            y = [getattr(loop, which).phase_margin for loop in loops]
            axes["plane"].errorbar(
                [q.value for q in x],
                [q.value for q in y],
                xerr=[1.96 * q.std_error for q in x],
                yerr=[1.96 * q.std_error for q in y],
                fmt=marker,
                color=colour,
                markersize=3.5,
                markerfacecolor="white",
                linewidth=0.5,
                label=f"{which} loop, {name}",
            )
            axes["plane"].plot(
                true.crossover,
                true.phase_margin,
                "k+",
                markersize=11.0,
                zorder=5.0,
                label="truth" if (name, which) == ("in motion", "disturbance") else None,
            )
    axes["magnitude"].axhline(1.0, color="#333333", linewidth=0.6)
    axes["magnitude"].set_ylabel("magnitude |L| [-]")
    axes["magnitude"].set_title("disturbance loop", loc="left")
    axes["phase"].axhline(-180.0, color="#333333", linewidth=0.6)
    axes["phase"].set_ylabel("phase [deg]")
    axes["phase"].set_xlabel("frequency [rad/s]")
    axes["plane"].set_xlabel("crossover frequency [rad/s]")
    axes["plane"].set_ylabel("phase margin [deg]")
    axes["plane"].set_title("both loops", loc="left")
    axes["plane"].set_xlim(1.9, 4.9)
    axes["plane"].legend(frameon=False, loc="upper right")
plt.show()

# %%
# Where only the visual channel acts both loops are one, and their points lie on one another.
