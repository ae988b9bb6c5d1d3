"""
The controlled element, identified
==================================

Loops need the controlled element.  Where a recording does not name it, it is identified from the
control, the disturbance and the output: the simplest of the usual forms that explains the output.
Here the element is that of a training experiment, 10.62(s+0.99)/(s(s²+2.58s+7.61)) (Pool, Harder
and van Paassen, 2016).
"""

import matplotlib.pyplot as plt
import numpy as np

import pilotid
from pilotid.element.fit import identified_element
from pilotid.pilot.element import ControlledElement
from pilotid.show.style import colour_of, journal_style, log_ticks

scenario = pilotid.SCENARIOS["training"]
recording = pilotid.simulate(scenario, 1)
found = identified_element(recording)
print(f"form {found.form}: {found.element.name}")
for quantity in found.parameters:
    print(f"  {quantity.key} = {quantity.value:.4g} ± {quantity.std_error:.2g} {quantity.unit}")
print(
    f"explains {found.explained:.4f} % of the output's power; "
    f"its response errs by {100.0 * found.response_error:.2g} %"
)
for candidate in found.candidates[:6]:
    print(
        f"  tried {candidate.form}: criterion {candidate.criterion:.1f}, "
        f"explains {candidate.explained:.2f} %"
    )

# %%
# For comparison, the ratio of the output to what the element was given, at the lines of both
# forcing functions.

lines = np.array(sorted({*recording.lines["ft"], *recording.lines["fd"]}))
given = np.fft.rfft(recording.window(recording.u + recording.fd)[0])[lines]
output = np.fft.rfft(recording.window(recording.x)[0])[lines]
at_lines = 2.0 * np.pi * lines / recording.duration

omega = np.geomspace(at_lines[0], at_lines[-1], 300)
true, own = scenario.element.response(omega), found.element.response(omega)
simpler = [
    ControlledElement((10.62 / 7.61 * 0.99,), (1.0, 0.0), name="K/s"),
    ControlledElement((10.62,), (1.0, 0.0, 0.0), name="K/s²"),
]

with journal_style():
    figure, (above, middle, below) = plt.subplots(
        3, 1, figsize=(5.6, 5.2), layout="constrained", sharex=True, height_ratios=(2, 1.6, 1)
    )
    for response, colour, dash, label in (
        (own, colour_of("mle"), "-", f"identified: {found.element.name}"),
        (true, "black", "--", "truth"),
        *(
            (e.response(omega), "#999999", dash, e.name)
            for e, dash in zip(simpler, ("-.", ":"), strict=True)
        ),
    ):
        above.loglog(omega, np.abs(response), dash, color=colour, label=label)
        middle.semilogx(omega, np.degrees(np.unwrap(np.angle(response))), dash, color=colour)
    points = output / given
    above.loglog(
        at_lines,
        np.abs(points),
        "o",
        color="#333333",
        markersize=3.0,
        markerfacecolor="white",
        label="x/(u + fd) at the lines",
    )
    middle.semilogx(
        at_lines,
        np.degrees(np.unwrap(np.angle(points))),
        "o",
        color="#333333",
        markersize=3.0,
        markerfacecolor="white",
    )
    inside = (omega > 0.5) & (omega < 6.0)
    below.semilogx(omega, 100.0 * (np.abs(own / true) - 1.0), color=colour_of("mle"))
    below.fill_between(
        omega[inside],
        -196.0 * found.response_error,
        196.0 * found.response_error,
        color=colour_of("mle"),
        alpha=0.2,
        linewidth=0.0,
        label="largest 95 % error, .5 to 6 rad/s",
    )
    below.axhline(0.0, color="#333333", linewidth=0.6)
    below.legend(frameon=False)
    above.set_ylabel("magnitude |x/(u + fd)|")
    middle.set_ylabel("phase [deg]")
    below.set_ylabel("error of the\nmagnitude [%]")
    below.set_xlabel("frequency [rad/s]")
    log_ticks(below, "x")
    above.legend(frameon=False)
plt.show()
