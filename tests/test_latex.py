"""Tables for papers: structure, digits, and what LaTeX would stumble over."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from tidy_rows import row, table

from pilotid.analysis.contrasts import contrasts
from pilotid.analysis.report_tables import tables_tex
from pilotid.analysis.rows import Row
from pilotid.estimates.quantities import SYMBOLS
from pilotid.support.format import for_latex

A = (1.12, 1.43, 0.91, 2.02, 1.31)
B = (1.61, 1.52, 1.73, 2.14, 2.25)


def checked(text: str) -> list[list[list[str]]]:
    """The cells of every tabular, once the structure is right."""
    lines = [line for line in text.splitlines() if not line.startswith("%")]
    body = "\n".join(lines)
    bare = re.sub(r"\\[{}]", "", body)
    depth = 0
    for letter in bare:
        depth += (letter == "{") - (letter == "}")
        assert depth >= 0
    assert depth == 0
    assert len(re.findall(r"(?<!\\)\$", body)) % 2 == 0
    found = []
    for columns, inside in re.findall(
        r"\\begin{longtable}{(\w+)}\n(.*?)\\end{longtable}", body, flags=re.DOTALL
    ):
        head, _, rest = inside.removeprefix("\\toprule\n").partition("\n\\midrule\n")
        rows = [head, *rest.partition("\\endlastfoot\n")[2].splitlines()]
        assert all(line.endswith(r" \\") for line in rows)
        cells = [re.split(r" (?<!\\)& ", line.removesuffix(r" \\")) for line in rows]
        assert {len(line) for line in cells} == {len(columns)}
        found.append(cells)
    assert body.count("{longtable}") == 2 * len(found)
    return found


def made(rows: Sequence[Row]) -> list[list[list[str]]]:
    return checked(tables_tex(rows, contrasts(rows)))


def test_means_over_subjects_and_contrasts() -> None:
    means, differences = made(table({"C1": A, "C2": B}))
    assert means == [
        ["parameter", "unit", "C1 (n = 5)", "C2 (n = 5)"],
        ["$T_L$", "s", "$1.36$ ($0.42$)", "$1.85$ ($0.33$)"],
    ]
    assert differences[0][4:6] == ["difference", r"95 \% interval"]
    assert differences[1][:6] == ["C1:C2", "$T_L$", "s", "$5$", "$0.49$", "[$0.01$, $0.98$]"]
    assert re.fullmatch(r"\$2\.\d\d\$ \(\$4\$\)", differences[1][6])


def test_values_that_are_not_determined_have_no_error() -> None:
    def rows(values: dict[str, tuple[float, ...]]) -> list[list[str]]:
        return made([replace(r, determined=r.subject != "1") for r in table(values)])[0]

    assert rows({"C1": A[:1]})[1][2] == "not determined"
    assert rows({"C1": A})[1][2] == "$1.36$ ($0.42$)†"


def test_names_cannot_break_the_tables() -> None:
    nasty = r"50%_$x$ {\bad} #1 ^2 ~ <&>|"
    rows = [
        row(s, c, float(s) * k, parameter=nasty, unit="m/s^2")
        for c, k in ((nasty, 1.0), ("b\n% c", 1.7))
        for s in "123"
    ]
    means, differences = made(rows)
    assert any(for_latex(nasty) in cell for cell in means[0])
    assert differences[1][1] == for_latex(nasty)


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="there is no pdflatex")
def test_every_table_compiles(tmp_path: Path) -> None:
    rows = table({"C_1 & 50 %": A, "C#2^~": B})
    keys = [*SYMBOLS, "Kvis*tlead", "own_key", "a<b"]
    rows = [replace(r, parameter=key, unit="deg²/s^2") for key in keys for r in rows]
    (tmp_path / "tables.tex").write_text(tables_tex(rows, contrasts(rows)), encoding="utf-8")
    (tmp_path / "paper.tex").write_text(
        r"\documentclass{article}\usepackage{booktabs,longtable}\begin{document}\input{tables}\end{document}"
    )
    command = ["pdflatex", "-halt-on-error", "-interaction=nonstopmode", "paper.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout.decode(errors="replace")[-2000:]
