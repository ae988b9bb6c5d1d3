"""What the first pages show: a picture of a comparison and of a fit, and the tables beside them.

    nox -s check -- front

Reads results/reference/summary.csv; writes docs/comparison.svg, docs/fit.svg and the tables of
README.md and paper/paper.md.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd

import pilotid
from pilotid.plots.page import svg
from pilotid.plots.style import JOURNAL, style_of

ROOT = Path(__file__).parents[2]
SCENARIO = pilotid.SCENARIOS["nominal"]
KEYS = list(SCENARIO.model.keys)
SHOWN = ["mle", "fourier", "arx", "sindy", "bayes", "mmle3"]


def reference() -> pd.DataFrame:
    """Scores of `nominal`, indexed by method and parameter."""
    rows = pd.read_csv(ROOT / "results/reference/summary.csv")
    return rows[rows["scenario"] == SCENARIO.name].set_index(["method", "parameter"])


def ranking(rows: pd.DataFrame) -> str:
    """The table of README and paper: what the estimates are worth, in Cramer-Rao bounds."""
    lines = ["| method | loss (95 % interval) | bias | scatter | claimed | coverage | a fit [ms] |"]
    lines += ["| --- | --- | ---: | ---: | ---: | ---: | ---: |"]
    times = json.loads((ROOT / "results/timings.json").read_text("utf-8"))["times"]
    for method in sorted(SHOWN, key=lambda name: rows.loc[(name, "all"), "loss"]):
        whole, each = rows.loc[(method, "all")], rows.loc[method].loc[KEYS]
        over = (each[c] / each["crlb"] for c in ("bias", "std", "mean_std_error"))
        numbers = [f"{np.sqrt(np.mean(ratio**2)):.1f}" for ratio in over]
        loss = f"{whole['loss']:.3g} ({whole['loss_lower']:.3g} to {whole['loss_upper']:.3g})"
        time = f"{times[f'fit[{method}-multi-1]']['ms']:.0f}"
        cells = [f"`{method}`", loss, *numbers, f"{100.0 * whole['coverage_95']:.0f} %", time]
        lines.append(f"| {' | '.join(cells)} |")
    took = f"*The quick comparison took {times['compare']['ms'] / 1000.0:.0f} s (`nox -s bench`).*"
    return "\n".join([*lines, "", took])


def comparison(rows: pd.DataFrame) -> str:
    """The picture of a comparison, as SVG: one panel a parameter."""
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(
        1, len(KEYS), figsize=(10.0, 3.4), layout="constrained", sharey=True
    )
    for axes, key in zip(panels, KEYS, strict=True):
        axes.axhspan(-1.0, 1.0, color="#9a9a9a", alpha=0.3, linewidth=0)
        for place, method in enumerate(SHOWN):
            row = rows.loc[(method, key)]
            bias, scatter, claimed = (
                row[name] / row["crlb"] for name in ("bias", "std", "mean_std_error")
            )
            colour, marker, _ = style_of(method)
            axes.bar(place, 2.0 * claimed, 0.5, bias - claimed, color=colour, alpha=0.3)
            axes.errorbar(
                place, bias, scatter, fmt=marker, color=colour, markersize=4.0,
                capsize=2.0, label=method,
            )  # fmt: skip
        axes.set_title(key)
        axes.set_xticks([])
        axes.set_yscale("symlog", linthresh=3.0)
    ticks = (-30, -10, -3, -2, -1, 0, 1, 2, 3, 10, 30)
    panels[0].set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    panels[0].set_ylabel("error [Cramér-Rao bounds]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(SHOWN), frameon=False)
    alt = "Bias, scatter, claimed error or posterior spread, and bound of six methods, by parameter"
    return svg(figure, "comparison", alt)


def fit() -> str:
    """The picture of a fit, as SVG: visual channel by `mle` and by `fourier`."""
    import matplotlib.pyplot as plt

    scenario = pilotid.SCENARIOS["single"]
    recording = pilotid.simulate(scenario, 1)
    found = [pilotid.identify(recording, scenario.model, name) for name in ("mle", "fourier")]
    figure, both = plt.subplots(2, 1, figsize=(7.2, 4.2), layout="constrained", sharex=True)
    pilotid.plot.describing_function(*found, truth=scenario.values, axes=both)
    alt = "Visual channel of one recording: mle with its band, fourier with error bars, and truth"
    return svg(figure, "fit", alt)


def enter(name: str, text: str) -> None:
    """Write a table between its marks in a page."""
    page = ROOT / name
    marks = r"(<!-- table: nox -s check -- front -->\n\n).*?(\n\n<!-- end of table -->)"
    body, places = re.subn(
        marks, lambda m: m[1] + text + m[2], page.read_text("utf-8"), flags=re.DOTALL
    )
    if places != 1:
        raise SystemExit(f"{name}: the table's two marks must be there once")
    page.write_text(body, "utf-8")


def main() -> None:
    mpl.use("Agg")
    rows = reference()
    table = ranking(rows)
    for name in ("README.md", "paper/paper.md"):
        enter(name, table)
    print(table)
    with mpl.rc_context(JOURNAL):
        for name, text in (("comparison", comparison(rows)), ("fit", fit())):
            file = ROOT / "docs" / f"{name}.svg"
            # Letters are black, also where a page is dark.
            text = text.replace(">", '><rect width="100%" height="100%" fill="white"/>', 1)
            file.write_text(f'<?xml version="1.0" encoding="utf-8"?>\n{text}', "utf-8")
            print(f"{file.relative_to(ROOT)}: {len(text) // 1024} kB")


if __name__ == "__main__":
    main()
