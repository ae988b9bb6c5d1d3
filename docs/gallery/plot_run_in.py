"""
Leakage, and what a run-in is worth
===================================

A remnant is not periodic in the window.  What it leaves in the pilot and in the loop at both ends
leaks to all frequencies, and above the pilot's band it exceeds the remnant itself.  ``fourier``
estimates the leakage beside each line (``trend``); methods in the time domain take the seconds
before the window, if they were recorded, or leave the first three of the window unscored.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import pilotid
from pilotid import Fourier
from pilotid.show.style import colour_of, journal_style, log_ticks

RECORDINGS = 16
KEYS = ("tdvis", "Kvest", "tdvest", "fnm", "dnm")
scenario = pilotid.SCENARIOS["nominal"]


def cut(recording):
    """The recording without its run-in."""
    window = {name: recording.window(getattr(recording, name)) for name in recording.signals}
    return replace(recording, **window, run_in=0)


WAYS = {
    "mle": ("mle", lambda r: r),
    "mle, no run-in": ("mle", cut),
    "fourier": (Fourier(), lambda r: r),
    "fourier, leakage left in": (Fourier(trend=None), lambda r: r),
}
recordings = [pilotid.simulate(scenario, seed) for seed in range(RECORDINGS)]
columns = [scenario.model.keys.index(key) for key in KEYS]
errors = {}
for name, (method, treated) in WAYS.items():
    fits = [pilotid.identify(method, treated(recording), "multi") for recording in recordings]
    kept = np.array([fit.values[columns] for fit in fits if fit.outcome.usable])
    errors[name] = 100.0 * (kept / scenario.values[columns] - 1.0)
    print(f"{name}: {len(kept)} of {len(fits)} fits count")

# %%
# What the true pilot leaves of the control is the remnant.  Its periodogram in the window, between
# the lines, as it comes and with a Hann taper, beside the spectrum that the simulation was given.

power = {"as it comes": [], "Hann taper": []}
count = recordings[0].samples
omega = 2.0 * np.pi * np.fft.rfftfreq(count, scenario.dt)
for recording in recordings:
    spectra = {}
    for name, taper in (("as it comes", np.ones(count)), ("Hann taper", np.hanning(count))):
        e, u, x = (np.fft.rfft(taper * recording.window(getattr(recording, s))[0]) for s in "eux")
        response = scenario.model.response(omega, scenario.values)
        left = u - response[0] * e + response[1] * x
        power[name].append(np.abs(left) ** 2 * scenario.dt / (np.pi * np.sum(taper**2)))
lines = {
    k for own in recordings[0].lines.values() for line in own for k in (line - 1, line, line + 1)
}
free = np.array([k for k in range(2, omega.size) if k not in lines and omega[k] < 40.0])

edges = np.geomspace(omega[2], 40.0, 40)
band = np.digitize(omega[free], edges)
middles = [omega[free][band == b].mean() for b in np.unique(band)]

with journal_style():
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(7.6, 3.2), layout="constrained", width_ratios=(1.0, 1.2)
    )
    for (name, own), colour in zip(power.items(), ("#D55E00", "#0072B2"), strict=True):
        mean = np.mean(own, axis=0)[free]
        smooth = [mean[band == b].mean() for b in np.unique(band)]
        left.loglog(middles, smooth, ".-", color=colour, label=name)
    shape = np.abs(scenario.remnant.filter(omega[1:])) ** 2
    measured = np.mean(power["Hann taper"], axis=0)
    low = (omega[1:] < 4.0) & np.isin(np.arange(1, omega.size), free)
    scale = measured[1:][low].sum() / shape[low].sum()
    shown = omega[1:] < 40.0
    left.loglog(
        omega[1:][shown], scale * shape[shown], "k--", linewidth=0.9, label="shape of the truth"
    )
    log_ticks(left, "x")
    left.set_xlabel("frequency [rad/s]")
    left.set_ylabel(f"power density [{recordings[0].units['u']}² s/rad]")
    left.legend(frameon=False, title="periodogram of the remnant")
    places = np.arange(len(KEYS))
    looks = (
        (colour_of("mle"), "^", "-"),
        (colour_of("mle"), "v", ":"),
        (colour_of("fourier"), "D", "-"),
        (colour_of("fourier"), "o", ":"),
    )
    for number, ((name, own), (colour, marker, dash)) in enumerate(
        zip(errors.items(), looks, strict=True)
    ):
        reach = 1.96 * own.std(axis=0, ddof=1) / np.sqrt(len(own))
        bars = right.errorbar(
            places + 0.16 * (number - 1.5),
            own.mean(axis=0),
            reach,
            fmt=marker,
            color=colour,
            markersize=4.5,
            markerfacecolor="white" if dash == ":" else colour,
            label=name,
        )
        bars[2][0].set_linestyle(dash)
    right.axhline(0.0, color="#333333", linewidth=0.6)
    right.set_xticks(places, KEYS)
    right.set_ylabel("bias [% of the true value]")
    right.legend(frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
plt.show()
