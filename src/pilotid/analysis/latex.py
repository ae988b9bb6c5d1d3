r"""Tables for a paper: booktabs tabulars without captions, for ``\input`` in a table of one's own.

Numbers have the digits that their errors allow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from pilotid.analysis.contrasts import Contrast
from pilotid.analysis.rows import (
    Chosen,
    Layout,
    Row,
    Stratum,
    by_table,
    in_order,
    layouts,
    mean_and_spread,
)
from pilotid.numbers import decimals
from pilotid.types import printable

SPECIAL = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
}
NOTHING = "--"
#: p-values below this are given as smaller.
LEAST = 0.001


def tables_tex(
    rows: Sequence[Row],
    contrasts: Sequence[Contrast] = (),
    chosen: Chosen | None = None,
    made_by: str = "pilotid analyse",
) -> str:
    """Estimates and contrasts as LaTeX.

    Parameters
    ----------
    rows
        Rows of estimates.csv and loops.csv; fits of all runs together are shown.
    contrasts
        Contrasts to show.
    chosen
        The model of each stratum and condition, as for `contrasts`.
    made_by
        The command that made them, for the comment at the head.

    Returns
    -------
    For each stratum and method (and model, unless one is chosen for each condition) a table of
    means over subjects, or, where no condition has two subjects, of every file's estimates; then
    one of contrasts.
    """
    parts = [
        f"% Made by: {printable(made_by)}",
        r"% Needs \usepackage{booktabs}; each tabular may be put into a table of its own.",
    ]
    groups = by_table(layouts(rows, chosen), one_model=chosen is None)
    for (stratum, method, _), group in groups.items():
        title = _title(stratum, method, [m for layout in group for m in layout.models.values()])
        if any(len(cells) > 1 for layout in group for cells in layout.cells.values()):
            parts += [
                f"% Means over subjects, standard deviations in brackets{title}",
                _means(group),
            ]
        else:
            parts += [f"% Estimates with their standard errors{title}", _values(group)]
    for title, some in _contrast_groups(contrasts):
        parts += [
            f"% Paired differences between conditions, b less a, over subjects{title}: difference "
            "with 95 % interval,",
            "% paired t-test, p after Holm's correction, Cohen's d_z with Hedges' correction",
            _contrasts(some),
        ]
    return "\n".join(parts) + "\n"


def escaped(text: str) -> str:
    """A text as LaTeX sets it, letter by letter."""
    return "".join(SPECIAL.get(letter, letter) for letter in printable(text))


def number(value: float, error: float, digits: int = 2) -> str:
    """A number in mathematics, with as many decimals as show these digits of its error."""
    if not math.isfinite(value):
        return NOTHING
    measure = error if math.isfinite(error) and error > 0.0 else abs(value) / 10.0
    places = decimals(measure, digits) if measure > 0.0 else 0
    text = f"{value:.{places}f}"
    return f"${text if float(text) else text.lstrip('-')}$"


def chance(p: float) -> str:
    """A p-value."""
    if not math.isfinite(p):
        return NOTHING
    return f"$<{LEAST:g}$" if p < LEAST else f"${p:.3f}$"


def tabular(columns: str, head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    """A booktabs tabular; the cells are LaTeX."""
    lines = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", _line(head), r"\midrule"]
    lines += [_line(row) for row in body]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _line(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"


def _named(parameter: str, unit: str) -> str:
    return escaped(f"{parameter} ({unit})" if unit else parameter)


def _title(stratum: Stratum, method: str, models: Sequence[str]) -> str:
    told = [f"{name} {value}" for name, value in stratum]
    told += [f"method {method}", f"model {', '.join(dict.fromkeys(models))}"]
    return f" ({printable('; '.join(told))})"


def _means(group: Sequence[Layout]) -> str:
    """Parameters down, conditions across: mean over subjects and their standard deviation."""
    conditions = in_order([c for layout in group for c in layout.conditions])
    counts = {c: len({s for layout in group for s in layout.cells.get(c, {})}) for c in conditions}
    body = []
    for layout in group:
        line = [_named(layout.parameter, layout.unit)]
        for condition in conditions:
            cells = [c for c in layout.cells.get(condition, {}).values() if not c.fault]
            mean, deviation = mean_and_spread(cells)
            shown = number(mean, deviation)
            if len(cells) > 1:
                fewer = f", $n = {len(cells)}$" if len(cells) < counts[condition] else ""
                shown += f" ({number(deviation, deviation)}{fewer})"
            line.append(shown)
        body.append(line)
    head = ["", *(f"{escaped(c or 'all')} ($n = {counts[c]}$)" for c in conditions)]
    return tabular("l" + "r" * len(conditions), head, body)


def _values(group: Sequence[Layout]) -> str:
    """Subjects and conditions down, parameters across: value and standard error."""
    places = dict.fromkeys(
        (condition, subject)
        for layout in group
        for condition, cells in layout.cells.items()
        for subject in cells
    )
    body = []
    for condition, subject in places:
        line = [escaped(subject), escaped(condition)]
        for layout in group:
            cell = layout.cells.get(condition, {}).get(subject)
            if cell is None or cell.fault:
                line.append(NOTHING)
                continue
            shown = number(cell.value, cell.std_error)
            if math.isfinite(cell.std_error):
                shown += rf" $\pm$ {number(cell.std_error, cell.std_error)}"
            line.append(shown)
        body.append(line)
    head = ["subject", "condition", *(_named(la.parameter, la.unit) for la in group)]
    return tabular("ll" + "r" * len(group), head, body)


def _contrast_groups(contrasts: Sequence[Contrast]) -> list[tuple[str, list[Contrast]]]:
    groups: dict[tuple[Stratum, str, str, str], list[Contrast]] = {}
    for c in contrasts:
        groups.setdefault((c.stratum, c.method, c.model_a, c.model_b), []).append(c)
    return [
        (_title(stratum, method, models), some)
        for (stratum, method, *models), some in groups.items()
    ]


def _contrasts(some: Sequence[Contrast]) -> str:
    body = []
    for c in some:
        interval = f"[{number(c.lower, c.std_error)}, {number(c.upper, c.std_error)}]"
        test = f"$t({c.freedom:.0f}) = {c.t:.2f}$" if math.isfinite(c.t) else NOTHING
        body.append(
            [
                escaped(c.condition_a if c.within else f"{c.condition_a}, {c.condition_b}"),
                _named(c.parameter, c.unit),
                str(c.subjects),
                number(c.difference, c.std_error),
                interval if math.isfinite(c.lower) else NOTHING,
                test,
                chance(c.p_holm),
                number(c.effect_size, 0.1, 2),
            ]
        )
    head = ["a, b", "parameter", "$n$", "difference", r"95\,\% interval", "test", "$p$", "$d_z$"]
    return tabular("llrrlrrr", head, body)
