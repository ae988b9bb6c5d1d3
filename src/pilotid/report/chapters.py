"""The experiments of a study's report."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from pilotid.report import curves as study_curves
from pilotid.report import figures as study_figures
from pilotid.report import tables as study_tables
from pilotid.report.content import Block, Bullets, Picture
from pilotid.report.paper import FIGURE_3, FIGURE_5, KEYS, PAPER, TABLE_3
from pilotid.report.rules import rules_for
from pilotid.report.verdicts import judge, sentence
from pilotid.study.comparison import Cell, Comparison
from pilotid.study.entries import TRAJECTORY, ScenarioEntry

SHORT = {
    "nominal": "both",
    "disturbance-only": "disturbance",
    "target-only": "target",
    "disturbance-step": "dist. step",
    "target-step": "target step",
}
VIOLATION = "violation"  # family of the scenarios that violate an assumption
MONTE_CARLO = "Bars: 95 % Monte Carlo intervals."


@dataclass(frozen=True)
class Chapter:
    """One experiment.

    Attributes
    ----------
    key, title, text
        Target of links, heading, and what it asks.
    scenarios
        Its scenarios that are in the store, in the order of the catalogue.
    blocks
        Its figures and tables but those of all numbers.
    tabled
        Scenarios whose numbers it shows in full.
    paper
        Bias and standard deviation [%] that the paper gives, by scenario.
    """

    key: str
    title: str
    text: str
    scenarios: tuple[str, ...]
    blocks: Sequence[Block]
    tabled: tuple[str, ...]
    paper: Mapping[str, Sequence[tuple[float, float]]] = field(default_factory=dict)


def chapters(study: Comparison, about: Mapping[str, str]) -> list[Chapter]:
    """The experiments whose scenarios are in the store; every other scenario is one by itself."""
    parts: list[Callable[[Comparison, Mapping[str, str]], Chapter | None]] = [
        _nominal,
        _starts,
        _remnant,
        _forcing,
        _single,
        _white,
        _length,
        _runs,
    ]
    found = [chapter for part in parts if (chapter := part(study, about))]
    told = {name for chapter in found for name in chapter.tabled}
    told |= set(_family(study, VIOLATION))  # in a chapter of their own, see `violations`
    told |= {name for name in study.names if f"{TRAJECTORY} {name}" in about}  # see `adapting`
    return found + [_other(study, name) for name in study.names if name not in told]


def paper_of(
    entry: ScenarioEntry, numbers: Sequence[tuple[float, float]]
) -> Sequence[tuple[float, float]]:
    """The paper's numbers, none if the scenario's parameters are not the paper's."""
    return numbers if tuple(p.parameter for p in entry.parameters) == KEYS else ()


def ratio(about: Mapping[str, str], scenario: str) -> float:
    """The remnant's share of the control's power that the study noted, NaN if it did not."""
    return float(about.get(f"remnant ratio {scenario}", "nan"))


def _present(study: Comparison, *names: str) -> tuple[str, ...]:
    return tuple(name for name in study.names if name in names)


def _family(study: Comparison, family: str) -> tuple[str, ...]:
    return tuple(name for name in study.names if study.entry(name).family == family)


def _errors(cells: Sequence[Cell], paper: Sequence[tuple[float, float]] = ()) -> Picture:
    name = cells[0].scenario.name
    beside = f"; the crosses are {PAPER}, Fig. 3 (10 runs, ± standard deviation)" if paper else ""
    alt = f"Mean error and scatter of each parameter by each method in scenario {name}"
    return Picture.of(
        study_figures.errors(cells, paper, PAPER),
        f"errors-{name}",
        alt,
        f"Scenario {name}: mean error, standard deviation and claimed standard error beside the "
        f"Cramér-Rao bound{beside}. Each panel has its own scale; a triangle marks a method whose "
        "mean error lies outside it.",
    )


def _nominal(study: Comparison, about: Mapping[str, str]) -> Chapter | None:
    if not (names := _present(study, "nominal")):
        return None
    cells = study.of("nominal")
    power = ratio(about, "nominal")
    share = f" ({100 * power:.0f} % of the control's power)" if math.isfinite(power) else ""
    alt = "Standard deviation and claimed standard error beside the Cramér-Rao bound"
    paper = paper_of(study.entry("nominal"), FIGURE_3)
    return Chapter(
        "nominal",
        "Both forcing functions (Fig. 3)",
        f"The paper's nominal case: target and disturbance, remnant gain 0.4{share}. The paper "
        "fits 10 runs with its own estimator, which `mmle3` repeats.",
        names,
        [
            _errors(cells, paper),
            Picture.of(
                study_figures.scatter(cells),
                "scatter-nominal",
                alt,
                "Scenario nominal: what the estimates scatter by, what the methods claim, and the "
                f"least that an unbiased estimate can scatter by. {MONTE_CARLO} A claim to the "
                "left of its point is too bold.",
            ),
        ],
        names,
        {"nominal": paper},
    )


def _starts(study: Comparison, about: Mapping[str, str]) -> Chapter | None:
    if not (names := _present(study, "starts")):
        return None
    entry, cells = study.entry("starts"), study.of("starts")
    same = bool(paper_of(entry, FIGURE_3))
    truths = [p.truth for p in entry.parameters]
    paper = [100.0 * e / t for e, t in zip(FIGURE_5, truths, strict=True)] if same else []
    alt = "Ends of the search from each start, by parameter and method"
    return Chapter(
        "starts",
        "Initial guesses (Fig. 5)",
        "One recording, fitted from initial guesses drawn within 40 % of the truth. The paper "
        "finds the same end from all ten (spread 1e-17); its recording is another one, so that its "
        "errors compare with ours in size only. A start reaches the common end if every parameter "
        "lies within a tenth of the bound of the median end; a failed fit does not reach it.",
        names,
        [
            Picture.of(
                study_figures.starts(cells, paper),
                "starts",
                alt,
                "Ends of the search, a dot for each start; behind the method's name the starts "
                f"that reach the common end. Dotted: {PAPER}, Fig. 5.",
            ),
            study_tables.starts_table(cells, paper),
        ],
        names,
    )


def _remnant(study: Comparison, about: Mapping[str, str]) -> Chapter | None:
    names = tuple(n for n in _family(study, "remnant") if _level(study, n) > 0.0)
    if not names:
        return None
    points = [(name, _level(study, name)) for name in names]

    def tick(name: str, gain: float) -> str:
        power = ratio(about, name)
        return f"{gain:.1f}\n{100 * power:.0f} %" if math.isfinite(power) else f"{gain:.1f}"

    noted = all(math.isfinite(ratio(about, n)) for n in names)
    label = "remnant gain" + (", and its share of the control's power" if noted else "")
    bias = "Bias over the remnant's gain, by parameter and method"
    std = "Standard deviation over the remnant's gain, by parameter and method"
    pictures: list[Block] = []
    if len(points) > 1:
        figure = study_curves.sweep(
            study, points, lambda s: (s.bias, s.bias_se), (label, "bias [% of true value]"),
            tick=tick,
        )  # fmt: skip
        caption = f"Bias over the remnant (Fig. 6). {MONTE_CARLO} Triangles lie outside the scale."
        pictures.append(Picture.of(figure, "remnant-bias", bias, caption))
        figure = study_curves.sweep(
            study, points, lambda s: (s.std, s.std_se), (label, "standard deviation [%]"),
            log=True, line=lambda s: s.bound, line_label="bound", tick=tick,
        )  # fmt: skip
        caption = f"Standard deviation over the remnant (Fig. 7). {MONTE_CARLO}"
        pictures.append(Picture.of(figure, "remnant-std", std, caption))
    paper = {"remnant-0.4": [b for b, _ in FIGURE_3]}
    told = [(n, n) for n in names if n in (names[0], "remnant-0.4", names[-1])]
    table = study_tables.bias_table(study, told, paper, "Bias by remnant gain")
    return Chapter(
        "remnant",
        "Power of the remnant (Figs 6 and 7)",
        "The paper draws bias and variance over the remnant's share of the control's power, 3 % "
        "at gain 0.1 to 32 % at gain 0.8, 10 runs a level, and leaves out the fits that failed: it "
        "explains by this why bias and variance fall again at the high end. It prints no numbers "
        "but those of gain 0.4 (Fig. 3).",
        names,
        [*pictures, table],
        names,
    )


def _level(study: Comparison, name: str) -> float:
    return study.entry(name).number("remnant.level")


def _forcing(study: Comparison, about: Mapping[str, str]) -> Chapter | None:
    own = _present(study, *(name for name in TABLE_3 if name != "nominal"))
    if not own:
        return None
    names = [name for name in TABLE_3 if name in study.names]
    named = [(name, SHORT[name]) for name in names]
    alt = "Bias of each parameter under each forcing function, by method"
    figure = study_curves.cases(study, named, TABLE_3, PAPER)
    return Chapter(
        "forcing",
        "Forcing functions (Fig. 8 and Table 3)",
        "Both forcing functions, one alone, and a step in place of the sines (positive for the "
        "first half, negative for the second). With the disturbance alone, forcing and remnant are "
        "four times nominal. The paper's numbers are means of 10 runs, or of 100: it says both.",
        tuple(names),
        [
            Picture.of(
                figure,
                "forcing",
                alt,
                f"Bias by forcing function. {MONTE_CARLO} The axis is linear within "
                f"±{study_curves.LINEAR:.0f} % (grey) and logarithmic beyond.",
            ),
            study_tables.bias_table(study, named, TABLE_3, "Bias, beside Table 3 of the paper", 2),
        ],
        own,
    )


def _single(study: Comparison, about: Mapping[str, str]) -> Chapter | None:
    text = (
        "The visual channel alone. The paper says that its biases are smaller than those of two "
        "channels, and prints no numbers of simulations."
    )
    return _plain(study, "single", "Single channel", text)


def _white(study: Comparison, about: Mapping[str, str]) -> Chapter | None:
    text = (
        "Not in the paper: the nominal case with a white remnant of 15 % of the control's power. "
        "A white residual is then the right assumption, so that every method based on it should be "
        "good here; what is left is the method's own error."
    )
    return _plain(study, "white-remnant", "Control experiment: a white remnant", text)


def _other(study: Comparison, name: str) -> Chapter:
    return _plain(study, name, f"Scenario {name}", study.entry(name).description + ".") or Chapter(
        name, name, "", (name,), (), (name,)
    )


def _plain(study: Comparison, name: str, title: str, text: str) -> Chapter | None:
    """A scenario by itself: what the rules say, and the errors."""
    if name not in study.names:
        return None
    cells, rules = study.of(name), rules_for(study.cells)
    blocks: list[Block] = [
        Bullets([sentence(judge(cell, rules)) for cell in cells]),
        _errors(cells),
    ]
    key = name if name != "single" else "single-channel"
    return Chapter(key, title, text, (name,), blocks, (name,))


def _length(study: Comparison, about: Mapping[str, str]) -> Chapter | None:
    text = (
        "Not in the paper: the nominal case over shorter and longer windows. The error of a "
        "consistent method falls with the bound, as 1/√T; that of an inconsistent one "
        "stops at its bias."
    )
    return _trend(study, "length", "Length of the recording", text, "duration", "window T [s]")


def _runs(study: Comparison, about: Mapping[str, str]) -> Chapter | None:
    text = (
        "Not in the paper: several runs with the same forcing functions and independent remnants, "
        "fitted jointly."
    )
    return _trend(study, "runs", "Number of runs", text, "runs", "runs fitted jointly")


def _trend(
    study: Comparison, family: str, title: str, text: str, varied: str, label: str
) -> Chapter | None:
    """Root mean square error over what a family of scenarios varies."""
    own = _family(study, family)
    if not own:
        return None
    names = (*_present(study, "nominal"), *own)
    points = sorted(((n, study.entry(n).number(varied)) for n in names), key=lambda p: p[1])
    known = [(name, x) for name, x in points if math.isfinite(x)]
    blocks: list[Block] = []
    if len(known) > 1:
        alt = f"Root mean square error by parameter and method over the {title.lower()}"
        figure = study_curves.sweep(
            study, known, lambda s: (s.rmse, s.rmse_se),
            (label, "rmse [% of true value]"),
            log=True, line=lambda s: s.bound, line_label="bound",
        )  # fmt: skip
        caption = f"Root mean square error and Cramér-Rao bound. {MONTE_CARLO}"
        blocks.append(Picture.of(figure, family, alt, caption))
    blocks.append(study_tables.ratio_table(study, [name for name, _ in points]))
    return Chapter(family, title, text, names, blocks, own)
