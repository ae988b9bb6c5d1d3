"""The report of a study, as a page and as Markdown, from its store alone, and its figures."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import numpy as np

from pilotid.plots.page import FIGURES, Figure, render, save_figures, write_page
from pilotid.plots.style import INK, journal_figure, style_of
from pilotid.report.study_tables import (
    advice,
    failure_table,
    key_of,
    loss_of,
    matrix,
    ranked,
    ranking,
    read_trust,
    trust_table,
)
from pilotid.study.scores import ALL, EFFICIENT, loss_text
from pilotid.study.table import LIMITS, USABLE, Comparison, is_ranked, judge, worst_parameter
from pilotid.support.disk import write_file
from pilotid.support.format import Table, table
from pilotid.support.naming import as_typed
from pilotid.support.numbers import Z95
from pilotid.support.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing
    from pandas import DataFrame

# ----------------------------------------------------------------------------------------- figures

COLUMNS = 4
LONGEST = 34  # characters of a method's label
#: Multiple of the typical method's extent at which an axis of errors ends at the latest.
MEDIANS = 4.0
BOUND = "#c9ced6"


@contextmanager
def panelled(
    titles: Sequence[str], height: float, labels: tuple[str, str]
) -> Iterator[tuple[Drawing, list[Axes], Axes]]:
    """A figure with a panel for each title, and axes in the spare place for the legend."""
    rows = -(-(len(titles) + 1) // COLUMNS)
    with journal_figure(height * rows) as figure:
        panels = list(figure.subplots(rows, COLUMNS, squeeze=False).flat)
        for title, axes in zip(titles, panels, strict=False):
            axes.set_title(title)
        for axes in panels[len(titles) :]:
            axes.axis("off")
        figure.supxlabel(labels[0], fontsize=8.0)
        if labels[1]:
            figure.supylabel(labels[1], fontsize=8.0)
        yield figure, panels[: len(titles)], panels[len(titles)]


def errors(study: Comparison, name: str) -> Drawing:
    """Mean error, scatter and claimed standard error beside the bound, by parameter and method.

    Parameters
    ----------
    study, name
        The study, and a scenario that is no population.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    tried = study.of(name)
    methods = list(tried.method[tried.usable > 0])
    scored = study.scores[(study.scores.scenario == name) & study.scores.method.isin(methods)]
    panels_of = dict(iter(scored[scored.parameter != ALL].groupby("parameter", sort=False)))
    labels = [m if len(m) <= LONGEST else f"{m[: LONGEST - 13]}...{m[-10:]}" for m in methods]
    # The legend needs some inches, too.
    height = max(1.35, 0.62 + 0.155 * len(methods))
    label = ("error [% of true value]", "")
    with panelled(list(panels_of), height, label) as (figure, panels, spare):
        for index, (axes, rows) in enumerate(zip(panels, panels_of.values(), strict=True)):
            _draw_errors(axes, rows)
            axes.set_ylim(len(labels) - 0.4, -0.6)
            axes.set_yticks(range(len(labels)), [""] * len(labels) if index % COLUMNS else labels)
        grey: dict[str, Any] = {"color": "#888888"}
        handles = [
            Line2D([], [], **grey, marker="o", linewidth=0, label="mean error"),
            Line2D([], [], color=INK, marker="|", label="its 95 % interval\n(Monte Carlo)"),
            Line2D([], [], **grey, label="± standard deviation"),
            Line2D([], [], **grey, alpha=0.45, linewidth=5, label="± claimed standard\nerror"),
            Patch(color=BOUND, linewidth=0, label="± Cramér-Rao bound"),
        ]
        spare.legend(handles=handles, loc="center", frameon=False)
    return figure


def _draw_errors(axes: Axes, scores: DataFrame) -> None:
    """One parameter's errors [% of the truth], a row a method; what lies far off at the edge."""
    scale = 100.0 / scores.truth.abs().where(scores.truth != 0.0)
    columns = ("bias", "bias_se", "std", "mean_std_error", "crlb")
    scaled = (scale * scores[column] for column in columns)
    bias, error, std, claimed, bounds = (series.to_numpy(dtype=float) for series in scaled)
    extents = np.abs(bias) + np.nan_to_num(np.fmax(std, claimed))
    reach = reach_of(extents, float(bounds[0]))
    if math.isfinite(bounds[0]):
        axes.axvspan(-bounds[0], bounds[0], color=BOUND, linewidth=0)
    axes.axvline(0.0, color=INK, linewidth=0.6)
    axes.set_xlim(-reach, reach)
    for row, method in enumerate(scores.method):
        (colour, marker, _), middle = style_of(method), bias[row]
        if abs(middle) > reach:
            right = middle > 0.0
            axes.plot(math.copysign(reach, middle), row, ">" if right else "<", color=colour,
                      markersize=4.5, clip_on=False)  # fmt: skip
            continue
        for half, width, alpha in ((claimed[row], 5.0, 0.45), (std[row], 1.0, 1.0)):
            axes.plot([middle - half, middle + half], [row, row], color=colour, linewidth=width,
                      alpha=alpha, solid_capstyle="butt")  # fmt: skip
        half = Z95 * error[row]
        axes.plot([middle - half, middle + half], [row, row], "|-", color=INK, linewidth=1.0,
                  markersize=4.4)  # fmt: skip
        axes.plot(middle, row, marker, color=colour, markersize=4.0,
                  markeredgecolor="white", markeredgewidth=0.4)  # fmt: skip
    axes.locator_params(axis="x", nbins=5)
    axes.tick_params(axis="y", length=0)


def reach_of(extents: FloatArray, bound: float) -> float:
    """Half of an axis about zero that shows most methods, and the bound, where some are far off."""
    known = extents[np.isfinite(extents)]
    typical = min(float(known.max()), MEDIANS * float(np.median(known))) if known.size else 0.0
    return 1.06 * max(typical, 1.2 * bound if math.isfinite(bound) else 0.0) or 1.0


# -------------------------------------------------------------------------------------- the report


REFERENCE = "nominal"
DETAILED = 3  # scenarios of which all is said at once; of more, of the first alone


def write_report(folder: Path, study: Comparison) -> Path:
    """Write report.html, report.md and the figures; equal stores give equal bytes.

    What a `trust.json` beside the store says comes first.  The Markdown has sentences and tables
    of the page's first screen.

    Parameters
    ----------
    folder
        Where to write.
    study
        What the store holds.

    Returns
    -------
    Path
        The page.
    """
    page, content = folder / "report.html", content_of(study)
    drawn = [part["figure"] for part in content["scenarios"] if part["figure"]]
    save_figures(folder / FIGURES, drawn, kinds=("svg",))
    write_page(page, "study.html", **content)
    # Sections that Markdown leaves out are no targets of links.
    short = re.sub(r"\[([^\]]+)\]\(#[\w-]+\)", r"\1", render("study.md", **content))
    write_file(folder / "report.md", short.encode("utf-8", "replace"))
    return page


def content_of(study: Comparison) -> dict[str, Any]:
    """What the page shows: sentences, tables and figures, by the names that its template has."""
    trust, scenarios = read_trust(study.folder), [_scenario(study, n) for n in study.scenarios]
    words, losses, rankings = overview(study)
    return {
        "title": "Pilot-model identification: methods compared",
        "trust": trust and (advice(trust), trust_table(trust), trust["unknown"]),
        "words": words,
        "losses": losses,
        "rankings": rankings,
        "limits": {"exact": EFFICIENT, **LIMITS},
        "scenarios": scenarios,
        "failures": failure_table(study),
        **provenance(study),
    }


def overview(study: Comparison) -> tuple[list[str], list[Table], list[Table]]:
    """The answer in sentences and tables, which the terminal and the page's first screen show."""
    names = compared(study)
    detailed = _detailed(names)
    words = [answer(study, name) for name in detailed]
    if prior := [f"`{m}`" for m, entry in study.methods.items() if entry.uses_prior]:
        words.append(
            f"* {', '.join(prior)} {'use' if len(prior) > 1 else 'uses'} prior knowledge: the "
            "range that parameters of pilots usually have. `bayes(prior=3)` has priors three times "
            "as wide."
        )
    losses = [matrix(study, names)] if len(names) > 1 else []
    words = words if study.scenarios else ["The study holds no fits yet."]
    return words, losses, [ranking(study, name) for name in detailed]


def compared(study: Comparison) -> list[str]:
    """Scenarios and populations of which means say something."""
    return [name for name, entry in study.scenarios.items() if not entry.one_recording]


def _detailed(names: Sequence[str]) -> Sequence[str]:
    """The scenarios whose rankings stand on the first screen."""
    if len(names) <= DETAILED:
        return names
    return [REFERENCE if REFERENCE in names else names[0]]


def answer(study: Comparison, name: str) -> str:
    """Which method to take in a scenario, how much better it is than the next, which to avoid."""
    every = ranked(study, name)
    order = [row for row in every if is_ranked(row)]
    if not order:
        return f"On `{name}` no method can be ranked: none gives intervals and seldom fails."
    best, *others = order
    scored, loss = study.scored(name, best.method), loss_text(*loss_of(best))
    grade, worst = judge(scored).grade, worst_parameter(scored)
    words = f"On `{name}`, **`{best.method}` is best** of {len(every)}: loss {loss}, {grade}"
    if grade == "poor":
        words = (
            f"On `{name}` no method is good enough: `{best.method}`, the best, is poor, with a "
            f"loss of {loss}"
        )
    words += f"; worst: {worst}." if worst else "."
    ratios = {row.method: study.ratio(name, row.method, best.method) for row in others}
    alike = [f"`{method}`" for method, (_, low, high) in ratios.items() if low <= 1.0 <= high]
    if alike:
        words += f" Not clearly worse (the ratio of losses may be 1): {', '.join(alike)}."
    poor = [f"`{row.method}`" for row in others if row.loss_lower >= USABLE]
    if poor and grade != "poor":
        words += f" **Do not use** {', '.join(poor)}: loss surely above {USABLE:g}."
    return words


def _scenario(study: Comparison, name: str) -> dict[str, Any]:
    """All on one scenario or population."""
    entry, names = study.scenarios[name], compared(study)
    remnant = ""
    if entry.remnant is not None:
        remnant = f"; remnant {100 * entry.remnant:.0f} % of the control's power"
    what = f"{entry.description[:1].upper()}{entry.description[1:]}{remnant}"
    one_truth = not (entry.population or entry.one_recording)
    drawn = one_truth and study.of(name).usable.any()
    caption = (
        f"Scenario {name}: mean error, standard deviation and claimed standard error beside the "
        f"Cramér-Rao bound. Each panel has its own scale; a triangle marks a method whose "
        f"mean error lies outside it. Numbers: [summary.csv](summary.csv), all scores: "
        "[scores.csv](scores.csv), each fit: [estimates.csv](estimates.csv)."
    )
    return {
        "key": key_of(name),
        "title": f"Scenario {name}",
        "what": f"{what}; model {entry.model}.",
        "folded": name in names and name not in _detailed(names),
        "ranking": ranking(study, name) if name in names and name not in _detailed(names) else None,
        "figure": Figure(f"errors-{key_of(name)}", errors(study, name), caption) if drawn else None,
    }


# ------------------------------------------------------------------------------ provenance

#: Facts on a study that are no versions.
OWN_FACTS = ("format", "seed", "code")


def command(study: Comparison) -> str:
    """What to type for the whole study."""
    entries = study.methods.items()
    methods = [e.typed or label for label, e in entries if "estimates" not in e.settings]
    imported = dict.fromkeys(f"{e.typed} " for _, e in entries if "estimates" in e.settings)
    folder = study.folder.name if study.folder.is_absolute() else str(study.folder)
    names = dict.fromkeys(entry.typed or name for name, entry in study.scenarios.items())
    return (
        f"pilotid compare --scenario {quote(','.join(names))} --method {quote(','.join(methods))} "
        f"--replications {study.replications()} --seed {study.about.get('seed', '?')} "
        f"{''.join(imported)}--out {quote(folder)}"
    )


def provenance(study: Comparison) -> dict[str, Any]:
    """The command of a study, its seed and versions, and all settings."""
    about = study.about
    facts = ", ".join(f"{key} {value}" for key, value in about.items() if key not in OWN_FACTS)
    entries = {**study.methods, **study.scenarios}
    settings = [(name, f"`{as_typed(entry.settings)}`") for name, entry in entries.items()]
    return {
        "command": command(study),
        "seed": f"Seed {about.get('seed', '?')}, code digest {about.get('code', '?')}; {facts}.",
        "settings": table(settings, "Methods and scenarios", ("name", "all that defines it")),
    }
