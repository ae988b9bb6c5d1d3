"""A figure of docs/theory/white.md and its table: 200 recordings of `nominal`.

nox -s check -- remnant         writes docs/remnant.svg and the table in docs/measurements.md
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.bounds import white_limit
from pilotid.datasets import scenario_named
from pilotid.datasets.experiments import experiment_of
from pilotid.study.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SCENARIO = "nominal"
DOCS = Path(__file__).parents[2] / "docs"
HEAD = ("parameter", "bound", "bias", "bias, long record", "claimed std", "true std") + (
    "true std, long record",
    "coverage",
    "bias",
    "claimed std",
    "true std",
    "coverage",
)
WHITE, MLE, BOUND = "#D55E00", "#0072B2", "#9A9A9A"  # Okabe and Ito, colour-blind safe


def scores_of(replications: int, seed: int) -> dict[str, list[Any]]:
    """Rows of scores of both methods, parameter by parameter."""
    study = Study((SCENARIO,), ("mle-white", "mle"), replications, seed)
    with TemporaryDirectory() as folder:
        found = study.run_in(Path(folder))
        return {m: list(found.scored(SCENARIO, m).itertuples())[1:] for m in found.methods}


def table(found: dict[str, list[Any]]) -> str:
    scenario = scenario_named(SCENARIO)
    limit = white_limit(experiment_of(scenario))
    scatter = np.sqrt(np.diag(limit.sandwich))
    lines = [
        f"| | {HEAD[1]} |" + " mle-white |" * 6 + " mle |" * 4,
        "| --- |" + " ---: |" * (len(HEAD) - 1),
        "| | % | " + " | ".join(h + ("" if h == "coverage" else " %") for h in HEAD[2:]) + " |",
    ]
    for white, mle, bias, deviation in zip(
        found["mle-white"], found["mle"], limit.bias, scatter, strict=True
    ):
        truth = white.truth
        numbers = (
            f"{100.0 * white.crlb / truth:.1f}",
            f"{white.bias_percent:+.1f} ± {100.0 * white.bias_se / truth:.1f}",
            f"{100.0 * bias / truth:+.1f}",
            f"{100.0 * white.mean_std_error / truth:.1f}",
            f"{100.0 * white.std / truth:.1f}",
            f"{100.0 * deviation / truth:.1f}",
            f"{white.coverage_95:.2f}",
            f"{mle.bias_percent:+.1f} ± {100.0 * mle.bias_se / truth:.1f}",
            f"{100.0 * mle.mean_std_error / truth:.1f}",
            f"{100.0 * mle.std / truth:.1f}",
            f"{mle.coverage_95:.2f}",
        )
        lines.append(f"| {white.parameter} | {' | '.join(numbers)} |")
    counts = ", ".join(f"{name} {s[0].n} of {s[0].n + s[0].failures}" for name, s in found.items())
    return "\n".join([*lines, "", f"Fits used: {counts}."]).replace("| -0.0 ", "| 0.0 ")


def draw(axes: Axes, white: Any, mle: Any) -> None:
    """One parameter: what each method claims, over what it does, over the bound."""
    scale = 100.0 / white.truth
    bound = scale * white.crlb
    axes.axhspan(-bound, bound, color=BOUND, alpha=0.35, linewidth=0)
    axes.axhline(0.0, color="#444444", linewidth=0.8)
    for place, score, colour, marker in ((0, white, WHITE, "o"), (1, mle, MLE, "s")):
        values = (score.bias, score.std, score.mean_std_error)
        centre, true, claimed = (scale * value for value in values)
        axes.errorbar(place, centre, yerr=true, color=colour, linewidth=1.4, capsize=4)
        axes.plot([place] * 2, [centre - claimed, centre + claimed], color=colour, linewidth=7,
                  alpha=0.55, solid_capstyle="butt")  # fmt: skip
        axes.plot(place, centre, marker, color=colour, markeredgecolor="white", markersize=6)
    axes.set_title(white.parameter, fontsize=10, family="monospace")
    axes.set_xlim(-0.6, 1.6)
    axes.set_xticks([])
    reach = max(abs(limit) for limit in axes.get_ylim())
    axes.set_ylim(-reach, reach)
    axes.locator_params(axis="y", nbins=7, steps=[1, 2, 5, 10])
    axes.tick_params(labelsize=8)
    for side in ("top", "right", "bottom"):
        axes.spines[side].set_visible(False)


def figure(found: dict[str, list[Any]], files: Sequence[Path]) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "pilotid"  # the same bytes each time
    import matplotlib.pyplot as plt
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    count = len(found["mle"])
    picture, panels = plt.subplots(1, count, figsize=(10.0, 3.6), layout="constrained")
    for axes, white, mle in zip(panels, found["mle-white"], found["mle"], strict=True):
        draw(axes, white, mle)
    panels[0].set_ylabel("error [% of the true value]", fontsize=9)
    handles = [
        Line2D([], [], color=WHITE, marker="o", linewidth=0, label="mle-white: mean error"),
        Line2D([], [], color=MLE, marker="s", linewidth=0, label="mle: mean error"),
        Line2D([], [], color="#444444", linewidth=7, alpha=0.55, label="± standard error claimed"),
        Line2D(
            [],
            [],
            color="#444444",
            linewidth=1.4,
            marker="|",
            markersize=9,
            label="± true standard deviation",
        ),
        Patch(color=BOUND, alpha=0.35, linewidth=0, label="± Cramér-Rao bound"),
    ]
    picture.legend(
        handles=handles, loc="outside lower center", ncols=5, fontsize=8.5, frameon=False
    )
    for file in files:
        picture.savefig(file, dpi=150, metadata={"Date": None} if file.suffix == ".svg" else None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--replications", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--png", type=Path, help="also write the figure as PNG")
    given = parser.parse_args()
    found = scores_of(given.replications, given.seed)
    figure(found, [DOCS / "remnant.svg", *([given.png] if given.png else [])])
    text = table(found)
    print(text)
    page = DOCS / "measurements.md"
    begin, end = "<!-- table: nox -s check -- remnant -->\n", "\n<!-- end of table -->"
    body, places = re.subn(
        f"{re.escape(begin)}.*?{re.escape(end)}",
        lambda _: f"{begin}\n{text}\n{end}",
        page.read_text(encoding="utf-8"),
        flags=re.DOTALL,
    )
    if places != 1:
        raise SystemExit(f"{page}: the table's two marks must be there once")
    page.write_text(body, encoding="utf-8")
    print(f"written: {page}, {DOCS / 'remnant.svg'}")


if __name__ == "__main__":
    main()
