"""Two published experiments, found again; the tables of docs/measurements.md.

    PILOTID_MEASURED=FOLDER nox -s check -- published             both
    PILOTID_MEASURED=FOLDER nox -s check -- published preview     Yamagami et al. (2019)
    PILOTID_MEASURED=FOLDER nox -s check -- published following   Bonnen et al. (2015)

FOLDER has the files of EmDash00/HILSuperposition-2017 in `preview`, and `data.mat` of
kbonnen/BonnenEtAl2015_KalmanFilterCode in `following`.
"""

from __future__ import annotations

import argparse
import os
import re
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from pandas import DataFrame
from scipy.io import loadmat

import pilotid
from pilotid.estimate.estimate import Estimate
from pilotid.estimate.quantities import FrequencyResponse
from pilotid.experiment.fits import predict_left_out
from pilotid.methods import method_named
from pilotid.methods.fourier import Fourier
from pilotid.model.catalogue import MODELS, SLOW
from pilotid.model.channel import Channel
from pilotid.model.element import element_named
from pilotid.model.factors import Gain, Lead
from pilotid.recording.recording import Recording, joined
from pilotid.support.types import FloatArray

FOLLOWING = MODELS["following"]
LOOK_AHEAD = MODELS["look-ahead"]
PURSUIT = MODELS["pursuit"]

DOCS = Path(__file__).parents[2] / "docs"
DT = 1.0 / 60.0
SUBJECTS = ("zu", "iz")  # of seven
ELEMENTS = {"fo": "1/s", "so": "1/(s(s+1))"}
LOW = 0.15  # Hz, up to which people are published to invert the element
#: The catalogue's model with a lead in place of the lag: the second-order element asks for it.
LED = replace(
    LOOK_AHEAD,
    name="look-ahead-led",
    channels=(
        LOOK_AHEAD.channels[0],
        Channel("feedback", "output", -1, (Gain("Kvis", 0.5), Lead("tlead"), *SLOW)),
    ),
).with_fixed(fnm=10.5, dnm=0.35)


# -------------------------------------------------------------------- Yamagami et al. (2019)


def preview_runs(folder: Path, subject: str, element: str) -> Recording:
    """All runs of a subject with an element: 40 s behind a ramp of 5 s."""
    runs = []
    for file in sorted(folder.glob(f"*_{subject}_{element}_*.csv")):
        # The ramp of 300 samples, and two periods of 1200; two samples more are another period's.
        target, control, disturbance, output = np.loadtxt(file, delimiter=",")[:2700, 2:6].T[
            :, None
        ]
        runs.append(
            Recording(
                DT, target - output, control, output, target, disturbance, 300, source=file.stem,
                controlled_element=ELEMENTS[element],
            )
        )  # fmt: skip
    return joined(runs)


def inverse_shares(response: FrequencyResponse, element: str) -> tuple[FloatArray, FloatArray]:
    """Feedforward times the element at the lines, 1 for its inverse, and the errors."""
    plant = element_named(ELEMENTS[element]).response(response.omega)
    return response.value[1] * plant, response.std[1] * np.abs(plant)


def mean_share(share: FloatArray, error: FloatArray, inside: FloatArray) -> str:
    """Mean of the real parts over some lines, weighted by their errors, each half of the power."""
    weights = 2.0 / error[inside] ** 2
    mean = float(np.sum(weights * share[inside].real) / np.sum(weights))
    return f"{mean:.2f} ± {np.sum(weights) ** -0.5:.2f}"


def preview(folder: Path) -> str:
    """Tables of feedforward and feedback."""
    keys = ("tlook + tdvis [s]", "VAF", "remarks")
    shares = _head("element", "subject", "runs", "F Hc to .15 Hz", "F Hc above")
    fits = _head("element", "subject", "method", *keys)
    for element in ELEMENTS:
        for subject in SUBJECTS:
            recording = preview_runs(folder, subject, element)
            found = Fourier().first_step(recording, PURSUIT)  # feedback on e, feedforward on ft
            share, error = inverse_shares(found, element)
            low = found.omega <= 2.0 * np.pi * LOW
            means = mean_share(share, error, low), mean_share(share, error, ~low)
            shares.append(_row(element, subject, recording.runs, *means))
            for method in ("mle", "fourier"):
                fit = pilotid.identify(recording, LED, method)
                fits.append(_row(element, subject, method, *fitted(fit)))
    return "\n".join([*shares, "", *fits, "", *left_out(folder)])


def left_out(folder: Path) -> list[str]:
    """Table of how well fits of all other runs predict each."""
    lines = _head("element", "model", "subject", "VAF by mle", "by fourier", "log-likelihood more")
    held = LOOK_AHEAD.with_fixed(fnm=10.5, dnm=0.35)
    methods = {name: method_named(name) for name in ("mle", "fourier")}
    for subject, (element, model) in product(SUBJECTS, [("fo", held), ("fo", LED), ("so", LED)]):
        rows = DataFrame(
            predict_left_out(preview_runs(folder, subject, element), model, methods, 1)
        ).pivot(index="run", columns="method", values=["vaf", "log_likelihood"])
        vaf, more = rows["vaf"].mean(), rows["log_likelihood"].diff(axis=1)["mle"].sum()
        shown = [f"{vaf[name]:.1f} %" for name in methods]
        lines.append(_row(element, model.name, subject, *shown, f"{more:.0f}"))
    return lines


def _head(*names: str) -> list[str]:
    return [_row(*names), _row(*["---"] * len(names))]


def _row(*cells: object) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def fitted(fit: Estimate) -> list[str]:
    """How far the response to the target is ahead of that to the output, VAF, remarks."""
    values = dict(zip(fit.model.keys, fit.values, strict=True))
    told = ", ".join(dict.fromkeys(r.code for r in fit.remarks if r.grade != "note")) or "-"
    return [f"{values['tdvis'] + values['tlook']:.2f}", f"{fit.vaf:.0f} %", told]


# ---------------------------------------------------------------------- Bonnen et al. (2015)


def following_runs(file: Path) -> dict[int, Recording]:
    """The runs of each width of the blob [arcmin]."""
    held = loadmat(file)
    widths = held["sigma"].ravel().astype(int)
    found = {}
    for width in np.unique(widths).tolist():
        target, cursor = (held[n][widths == width].astype(float) for n in ("target", "response"))
        middle = target.mean(axis=1, keepdims=True)
        target, cursor = target - middle, cursor - middle
        found[width] = Recording(
            DT, target - cursor, cursor, cursor, target, np.zeros_like(target),
            source=f"sigma {width}", controlled_element="1",
        )  # fmt: skip
    return found


def correlogram_lag(recording: Recording) -> float:
    """Lag [s] at which the velocities of cursor and target go together most, by a parabola."""
    velocities = (np.diff(own, axis=1) for own in (recording.input("ft"), recording.u))
    target, cursor = (np.fft.rfft(v - v.mean(axis=1, keepdims=True), 4096) for v in velocities)
    together = np.fft.irfft(np.mean(cursor * target.conj(), axis=0))[:120]
    top = int(np.argmax(np.convolve(together, np.ones(5) / 5.0, "same")))
    near = np.arange(max(top - 4, 0), top + 5)
    bend, slope, _ = np.polyfit(near, together[near], 2)
    return float(-0.5 * slope / bend * DT)


def following(folder: Path) -> str:
    """Table of the lag over the width of the blob."""
    head = ("tlagt [s]", "tdt [s]", "lag of the correlogram [s]", "Kt", "VAF")
    lines = _head("width [arcmin]", *head)
    for width, recording in following_runs(folder / "data.mat").items():
        fit = pilotid.identify(recording, FOLLOWING, "mle")
        values = dict(zip(fit.model.keys, fit.values, strict=True))
        errors = dict(zip(fit.model.keys, fit.std_error, strict=True))
        peak = correlogram_lag(recording)
        shown = [f"{values[key]:.3f} ± {errors[key]:.3f}" for key in ("tlagt", "tdt")]
        gain = f"{values['Kt']:.3f} ± {errors['Kt']:.3f}"
        lines.append(_row(width, *shown, f"{peak:.2f}", gain, f"{fit.vaf:.0f} %"))
    return "\n".join(lines)


# ------------------------------------------------------------------------------- the page


def entered(name: str, text: str) -> None:
    """Write a table to the page."""
    page = DOCS / "measurements.md"
    begin, end = f"<!-- table: {name} -->\n", "\n<!-- end of table -->"
    body, places = re.subn(
        f"{re.escape(begin)}.*?{re.escape(end)}",
        lambda _: f"{begin}\n{text}\n{end}",
        page.read_text(encoding="utf-8"),
        flags=re.DOTALL,
    )
    if places != 1:
        raise SystemExit(f"{page}: the marks of the table {name} must be there once")
    page.write_text(body, encoding="utf-8")


def main() -> None:
    made = {"preview": preview, "following": following}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", nargs="?", choices=list(made))
    folder = os.environ.get("PILOTID_MEASURED")
    if not folder:
        raise SystemExit("PILOTID_MEASURED names no folder of recordings")
    only = parser.parse_args().name
    for name in [only] if only else made:
        text = made[name](Path(folder) / name)
        print(f"{text}\n")
        entered(name, text)


if __name__ == "__main__":
    main()
