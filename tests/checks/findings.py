"""Published findings, found again on the measured recordings: contrasts of conditions by `mle`.

    nox -s check -- findings

PILOTID_MEASURED names the folder of the recordings.  Zaal (JGCD 39(5) 2016): C2 against C1 in roll
and pitch, nine pilots there and five here.  The yaw experiment: motion (C6, `multi`) against none
(C3, `single`), six pilots there and three here; and how much its runs differ, fitted one by one,
beside simulated pilots who do not vary.  Elsewhere the runs of a recording are fitted together.
"""

from __future__ import annotations

import argparse
import math
import os
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from pilotid.analysis.contrasts import Contrast, contrasts
from pilotid.analysis.rows import Row
from pilotid.api import identify
from pilotid.pilot.catalogue import MODELS
from pilotid.pilot.element import element_named
from pilotid.pilot.loops import margins
from pilotid.recordings.files import load_recording
from pilotid.recordings.recording import SIGNALS, Recording

#: t over nine pilots by axis and parameter; beyond 2.306 it is significant at 5 %.
#: The sign is that of C2 less C1; None where the paper gives the size of t alone.
PUBLISHED = {
    "roll": {"Kvis": (1.47, None), "tlead": (6.96, 1), "tdvis": (0.51, None), "dnm": (1.36, None)},
    "pitch": {"Kvis": (5.34, -1), "tlead": (13.8, 1), "tdvis": (4.35, 1), "dnm": (0.48, None)},
}
LIMIT_OF_NINE = 2.306
#: Differences over six pilots, C6 less C3.
YAW = {"tlead": "-0.9", "tdvis": "+0.03", "disturbance_crossover": "+0.5 (2.4 to 2.9)"}
ELEMENT = "15/s^2"


def rows_of(recording: Recording, fields: dict[str, str], name: str) -> Iterator[Row]:
    """Rows of the fit of a recording's runs together."""
    estimate = identify("mle", recording, name)
    found = [(q.key, q.unit, q.value, q.std_error, q.lower, q.upper) for q in estimate.parameters]
    if "axis" not in fields:
        loop = margins(MODELS[name], estimate.values, element_named(ELEMENT))[1].crossover
        nan = math.nan
        found.append(("disturbance_crossover", "rad/s", loop, nan, nan, nan))
    ended = estimate.outcome.slug, estimate.outcome.usable, estimate.remarks
    place = recording.source, tuple(fields.items()), None, name, "mle"
    for key, unit, *numbers in found:
        yield Row(*place, key, unit, *numbers, *ended)


def run_of(recording: Recording, run: int) -> Recording:
    """One run of a recording."""
    parts = {name: getattr(recording, name) for name in SIGNALS}
    cut = {name: None if part is None else part[run : run + 1] for name, part in parts.items()}
    return replace(recording, **cut)


def told(contrast: Contrast) -> str:
    """A contrast in one line."""
    c = contrast
    return (
        f"{c.parameter:22s} n {c.subjects}  {c.mean_a:8.4f} -> {c.mean_b:8.4f}  difference "
        f"{c.difference:+8.4f} ({c.lower:+.4f} .. {c.upper:+.4f})  t({c.freedom:.0f}) {c.t:6.2f}  "
        f"p {c.p:.4f}  d_z {c.effect_size:5.2f}  weighted {c.weighted_difference:+8.4f}, "
        f"p {c.weighted_p:.4f}; between subjects {c.between_subjects:.4f}, claimed "
        f"{c.claimed_error:.4f}"
    )


def adaptation(folder: Path) -> bool:
    """Print C2 against C1 beside the paper; whether signs and significances are the paper's."""
    rows = []
    for file in sorted(folder.glob("pilot*_C[12]_*.mat")):
        names = re.fullmatch(r"pilot(?P<subject>\d+)_(?P<condition>C\d)_(?P<axis>\w+)", file.stem)
        if names:
            rows += rows_of(load_recording(file), names.groupdict(), "single")
    found = contrasts(rows, [("C1", "C2")])
    agrees = True
    for axis, published in PUBLISHED.items():
        print(f"\n{axis}, C2 less C1, model single")
        for contrast in found:
            if dict(contrast.stratum)["axis"] != axis or contrast.parameter not in published:
                continue
            size, sign = published[contrast.parameter]
            significant = size > LIMIT_OF_NINE
            same = (contrast.p < 0.05) == significant
            same &= sign is None or sign * contrast.difference > 0.0
            agrees &= same
            print(f"  {told(contrast)}")
            print(
                f"  {'':22s} published: |t(8)| {size}, "
                f"{'significant' if significant else 'not significant'}"
                f"{', ' + ('+' if sign > 0 else '-') if sign else ''}: "
                f"{'the same here' if same else 'not so here'}"
            )
            for note in contrast.notes:
                print(f"  {'':22s} {note}")
    return agrees


def yaw(folder: Path) -> None:
    """Print C6 against C3 beside what is published."""
    models = {"C3": "single", "C6": "multi"}
    rows = []
    for condition, model in models.items():
        for file in sorted(folder.glob(f"*_subj*_{condition}.mat")):
            subject = re.sub(r".*_subj(\d+)_.*", r"\1", file.stem)
            fields = {"subject": subject, "condition": condition}
            rows += rows_of(load_recording(file), fields, model)
    chosen = {((), condition): model for condition, model in models.items()}
    print(f"\nyaw, C6 (multi) less C3 (single); loops with {ELEMENT}")
    for contrast in contrasts(rows, [("C3", "C6")], chosen):
        print(f"  {told(contrast)}")
        if contrast.parameter in YAW:
            print(f"  {'':22s} published over six pilots: {YAW[contrast.parameter]}")
        for note in contrast.notes:
            print(f"  {'':22s} {note}")


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    where = os.environ.get("PILOTID_MEASURED")
    if not where:
        raise SystemExit("PILOTID_MEASURED must name the folder of the recordings")
    agrees = adaptation(Path(where) / "adaptation")
    yaw(Path(where) / "yaw")
    print(f"\nC1 against C2: {'all as published' if agrees else 'NOT all as published'}")
    raise SystemExit(0 if agrees else 1)


if __name__ == "__main__":
    main()
