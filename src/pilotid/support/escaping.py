"""Text from anywhere made harmless, once for each form in which documents are written.

Texts hold `code`, **strong** words and links as `LINK` has them: into the page, or to a file beside
it or above it.  Whatever else means something in a form is escaped there, and control characters,
marks of direction and lone surrogates are in all.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from pilotid.support.types import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LINK = r"\[([^\]]+)\]\((#[\w-]+|(?:[\w.-]+/)+[\w.+-]+|[\w-]+\.csv)\)"
LONGEST_LABEL = 200  # characters of a text in a figure
GREEK = {
    "tau": "τ",
    "omega": "ω",
    "zeta": "ζ",
    "sigma": "\N{GREEK SMALL LETTER SIGMA}",
    "varphi": "φ",
}
LATEX = {
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
    "±": r"$\pm$",
}


def clean(text: str) -> str:
    """A text on one line, without anything that acts on a terminal or that XML cannot hold."""
    return text if text.isprintable() else printable(" ".join(text.splitlines()))


def for_terminal(text: str) -> str:
    """A text without marks; its lines stay."""
    plain = re.sub(LINK, r"\1", text).replace("`", "").replace("**", "")
    return "\n".join(map(clean, plain.split("\n")))


def for_html(text: str) -> str:
    """A text as HTML."""
    from markupsafe import escape

    safe = str(escape(clean(text)))
    safe = re.sub(r"`([^`]+)`", r"<code>\1</code>", safe)
    safe = re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", safe)
    safe = safe.replace(" %", "&nbsp;%")
    return re.sub(LINK, r'<a href="\2">\1</a>', safe)


def math_html(formula: str) -> str:
    """A formula of letters, indices and powers as HTML; other commands lose their backslash."""
    text = re.sub(r"\\mathrm\{(\w+)\}", r"\1", for_html(formula.strip("$")))
    text = re.sub(r"\\([a-z]+)", lambda m: GREEK.get(m[1], m[1]), text).replace(r"\,", " ")
    for sign, tag in (("_", "sub"), ("^", "sup")):
        text = re.sub(rf"\{sign}(?:\{{([^}}]*)\}}|(.))", rf"<{tag}>\1\2</{tag}>", text)
    return text


def for_markdown(text: str) -> str:
    """A text as Markdown, in which no other link, image or tag is one."""
    words, *linked = re.split(LINK, clean(text))
    return _signs(words) + "".join(
        f"[{_signs(name)}]({place}){_signs(words)}"
        for name, place, words in zip(linked[::3], linked[1::3], linked[2::3], strict=True)
    )


def _signs(text: str) -> str:
    text = text.replace("&", "&amp;").replace("<", "&lt;")
    return re.sub(r"[\[\]]", r"\\\g<0>", text)


def for_latex(text: str) -> str:
    """A text as LaTeX sets it, letter by letter."""
    return "".join(LATEX.get(letter, letter) for letter in clean(text))


def clean_drawing(drawing: Figure) -> None:
    """Make all texts of a figure such that they can be drawn; formulas that are none stay text."""
    from matplotlib.mathtext import MathTextParser
    from matplotlib.text import Text

    def cleaned(label: str) -> str:
        return "\n".join(map(clean, label.split("\n")))[:LONGEST_LABEL]

    for axis in (axis for axes in drawing.axes for axis in (axes.xaxis, axes.yaxis)):
        labels = [text.get_text() for text in axis.get_ticklabels()]
        if any(label != cleaned(label) for label in labels):  # a formatter sets them anew
            axis.set_ticks(axis.get_majorticklocs(), labels=[*map(cleaned, labels)])
    for text in drawing.findobj(Text):
        assert isinstance(text, Text)
        given = text.get_text()
        words = cleaned(given)
        if words != given:
            text.set_text(words)
        if "$" in words:
            try:
                MathTextParser("path").parse(words)
            except Exception:
                text.set_parse_math(False)
