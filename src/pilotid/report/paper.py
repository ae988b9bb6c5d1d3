"""The experiments of the paper that a study repeats, beside the paper's own numbers.

Berger, Zaal, Mulder and van Paassen, *Time Domain Pilot Model Identification Using Optimum
Likelihood Estimation*, AIAA 2008-7109.  Its numbers stand beside ours for comparison; nothing is
tuned to them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from pilotid.report.study_figures import PAPER, errors, sweep
from pilotid.report.study_tables import all_numbers, bias_table
from pilotid.study.comparison import Comparison
from pilotid.study.entries import ScenarioEntry
from pilotid.support.document import Block, Figure, Section, Text

#: Order of the paper's numbers.
KEYS = ("Kvis", "tlead", "tdvis", "Kvest", "tdvest", "fnm", "dnm")
#: Fig. 3: bias and standard deviation [%] of 10 runs.
BIAS = (10.8, -4.6, -2.6, -11.6, 16.0, -3.4, -9.2)
DEVIATION = (44.0, 51.0, 3.1, 18.0, 5.7, 6.5, 4.4)
#: Fig. 5: error of the estimates of one record, in the parameters' units.
FIGURE_5 = (0.0144, -0.209, -0.00283, -0.377, 0.0482, -0.575, -0.0416)
#: Table 3: bias [%] by scenario.
TABLE_3 = {
    "nominal": (12.37, -13.32, -3.63, -10.50, 15.88, -3.76, -9.67),
    "disturbance-only": (-6.28, -27.20, 406.72, 41.26, 144.95, -3.59, -17.14),
    "target-only": (8.97, -40.16, -5.81, -10.89, 38.50, -11.90, -35.51),
    "disturbance-step": (0.97, -1.29, 15.12, -3.82, 19.36, 1.70, -33.60),
    "target-step": (12.61, -7.68, 0.38, -2.58, 7.81, -0.81, -9.29),
}

TEXT = (
    f"{PAPER}: Berger, Zaal, Mulder and van Paassen, Time Domain Pilot Model Identification Using "
    "Optimum Likelihood Estimation, 2008. It fits with its own estimator, which `mmle3` repeats, "
    "and leaves failed fits out of its means, as bias and standard deviation here do."
)
INFERRED = (
    "Two things the paper does not state are **inferred**. The controlled element is K/s² with "
    "K = 4: there both forcing functions, whose amplitudes the paper does give, cause the same "
    "variance of the output. The remnant's filter is a second-order low-pass with a level at which "
    "gains 0.1 and 0.8 give about the 3 % and 32 % of the control's power that the paper names. "
    "Biases of methods that assume a white residual depend on this filter."
)


def paper_of(entry: ScenarioEntry) -> Sequence[tuple[float, float]]:
    """The paper's numbers of a scenario; none if it is not one that the paper gives them of."""
    is_known = entry.name == "nominal" and _is_papers(entry)
    return list(zip(BIAS, DEVIATION, strict=True)) if is_known else ()


def paper_sections(study: Comparison) -> list[Section]:
    """The paper's experiments whose scenarios are in the study, beside the paper's numbers."""
    own = [entry for entry in study.scenarios if _is_papers(entry)]
    found = [_forcing(study, own), _remnant(study, own), _starts(study, own)]
    blocks = [block for part in found for block in part]
    if not blocks:
        return []
    title = "The paper's experiments"
    return [Section("paper", title, [Text(TEXT), *blocks, Text(INFERRED)], folded=True)]


def _is_papers(entry: ScenarioEntry) -> bool:
    named = entry.name in (*TABLE_3, "starts") or entry.family == "remnant"
    return named and tuple(p.parameter for p in entry.parameters) == KEYS


def _forcing(study: Comparison, own: Sequence[ScenarioEntry]) -> list[Block]:
    names = [entry.name for entry in own if entry.name in TABLE_3]
    if not names:
        return []
    text = (
        "**Forcing functions (Fig. 8 and Table 3).** Both forcing functions, one alone, and a step "
        "in place of the sines. With the disturbance alone, forcing and remnant are four times "
        "nominal. The paper's numbers are means of 10 runs, or of 100: it says both."
    )
    return [Text(text), bias_table(study, names, TABLE_3, "Bias, beside Table 3 of the paper")]


def _remnant(study: Comparison, own: Sequence[ScenarioEntry]) -> list[Block]:
    points = [(e.name, e.number("remnant.level")) for e in own if e.family == "remnant"]
    points = [(name, level) for name, level in points if level > 0.0]
    if len(points) < 2:
        return []
    text = (
        "**Power of the remnant (Figs 6 and 7).** The paper draws bias and variance over the "
        "remnant's share of the control's power, 10 runs a level, and leaves out the fits that "
        "failed: it explains by this why bias and variance fall again at the high end. It prints "
        "no numbers but those of gain 0.4."
    )

    def tick(name: str, level: float) -> str:
        power = study.remnant_ratio(name)
        return f"{level:.1f}\n{100 * power:.0f} %" if math.isfinite(power) else f"{level:.1f}"

    label = "remnant gain, and its share of the control's power"
    labels = (label, "bias [% of true value]"), (label, "standard deviation [%]")
    bias = sweep(study, points, lambda s: s.bias, labels[0], tick=tick)
    std = sweep(study, points, lambda s: s.std, labels[1], log=True, tick=tick)
    return [
        Text(text),
        Figure("remnant-bias", bias, "Bias over the remnant. Triangles lie outside the scale."),
        Figure("remnant-std", std, "Standard deviation over the remnant."),
        bias_table(study, [n for n, _ in points], {"remnant-0.4": BIAS}, "Bias by remnant gain"),
    ]


def _starts(study: Comparison, own: Sequence[ScenarioEntry]) -> list[Block]:
    entry = next((entry for entry in own if entry.name == "starts"), None)
    if entry is None:
        return []
    cells = study.of(entry.name)
    pairs = zip(FIGURE_5, entry.parameters, strict=True)
    paper = [(100.0 * error / p.truth, 0.0) for error, p in pairs]
    text = (
        "**Initial guesses (Fig. 5).** One recording, fitted from initial guesses drawn within "
        "40 % of the truth. The paper finds one end from all ten (spread 1e-17); its recording "
        "is another one, so that its errors compare with ours in size only. A start reaches the "
        "common end if every parameter lies within a tenth of the bound of the median end."
    )
    caption = (
        "Ends of the search: each (dots), mean and standard deviation over the starts; crosses: "
        f"{PAPER}, Fig. 5."
    )
    return [
        Text(text),
        Figure("starts", errors(cells, paper, dots=True), caption),
        all_numbers(cells, paper),
    ]
