"""SVG figures that share a page: small, without clashing ids, and with their own fonts."""

from __future__ import annotations

import io
import re
from collections import Counter
from typing import TYPE_CHECKING
from zlib import crc32

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FONTS = "DejaVu Sans, Verdana, Helvetica, Arial, sans-serif"


def compact(figure: Figure, name: str, alt: str) -> str:
    """A figure as an SVG element, the same bytes for the same figure.

    Parameters
    ----------
    figure
        The figure.
    name
        Tells it from the other figures of a page: no two share an id or a class.
    alt
        What the figure shows, for those who do not see it.
    """
    text = svg(figure)
    text = re.sub(r"\s*<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # The style sheet would hold for the whole page; the root element says the same.
    text = re.sub(r"\s*<style[^>]*>\*\{stroke-linejoin: round; .*?</style>", "", text)
    text = re.sub(r"\s*<defs>\s*</defs>", "", text)
    own = f"f{crc32(name.encode()) % 16**5:05x}"
    text = _own_ids(text, own)
    text = re.sub(r"font-family: [^;\"]*;? ?", "", text)
    text = re.sub(r"font: (?:(\d+|bold) )?([\d.]+px) [^;\"]*", _font, text)
    text = re.sub(r"(?<![#\w.])-?\d+\.\d{3,}(?![\w.])", _short, text)
    text = re.sub(r" transform=\"rotate\(-?0 [^)]*\)\"", "", text)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r" d=\"[^\"]*\"", _tight, text)
    text = _without_bare_groups(text)
    text = _with_classes(re.sub(r"\n\s*", "\n", text), own)
    text = _joined_paths(_shared_markers(text))
    uses = r"<g ([^>]*)>\n((?:<use [^>]*( class=\"[^\"]*\")/>\n)(?:<use [^>]*\3/>\n)*)</g>"
    text = re.sub(uses, lambda m: f"<g {m[1]}{m[3]}>\n{m[2].replace(m[3], '')}</g>", text)
    head = (
        f'<svg role="img" aria-label="{_attribute(alt)}" font-family="{FONTS}" '
        'stroke-linejoin="round" stroke-linecap="butt"'
    )
    return text.replace("<svg", head, 1).strip() + "\n"


def _own_ids(text: str, name: str) -> str:
    """Only ids that something refers to, short and with the figure's own beginning."""
    used = re.findall(r"(?:url\(|href=\")#([^)\"]+)", text)
    short = {old: f"{name}i{number}" for number, old in enumerate(dict.fromkeys(used))}

    def renamed(found: re.Match[str]) -> str:
        return f' id="{short[found[1]]}"' if found[1] in short else ""

    text = re.sub(r" id=\"([^\"]+)\"", renamed, text)
    return re.sub(r"(url\(|href=\")#([^)\"]+)", lambda m: f"{m[1]}#{short[m[2]]}", text)


def _tight(path: re.Match[str]) -> str:
    """A path without the white space that it does not need."""
    return re.sub(r"\s*([MLCQzZ])\s*", r"\1", path[0]).replace("\n", " ").replace('  "', '"')


def _without_bare_groups(text: str) -> str:
    """Leave out groups without attributes, which say nothing."""
    kept: list[bool] = []

    def group(found: re.Match[str]) -> str:
        if found[0] == "</g>":
            return found[0] if kept.pop() else ""
        kept.append(found[0] != "<g>")
        return found[0] if kept[-1] else ""

    return re.sub(r"<g\b[^>]*>|</g>", group, re.sub(r"<g\b[^>]*/>", "", text))


def _with_classes(text: str, name: str) -> str:
    """Styles that come often as classes of the figure's own."""
    often = [
        s for s, count in Counter(re.findall(r" style=\"([^\"]*)\"", text)).items() if count > 2
    ]
    rules = []
    for number, style in enumerate(often):
        text = text.replace(f' style="{style}"', f' class="{name}c{number}"')
        rules.append(f".{name}c{number}{{{style.replace(': ', ':').replace('; ', ';')}}}")
    return re.sub(r"(<svg[^>]*>)", rf"\1\n<style>{''.join(rules)}</style>", text, count=1)


def _shared_markers(text: str) -> str:
    """Each shape of a marker once; matplotlib defines it for each line again."""
    first: dict[str, str] = {}
    renamed: dict[str, str] = {}

    def defined(found: re.Match[str]) -> str:
        name, shape = found[1], found[2]
        if shape in first:
            renamed[name] = first[shape]
            return ""
        first[shape] = name
        return found[0]

    text = re.sub(r"<defs>\n<path id=\"([^\"]+)\" ([^>]*)/>\n</defs>\n", defined, text)
    return re.sub(r"href=\"#([^\"]+)\"", lambda m: f'href="#{renamed.get(m[1], m[1])}"', text)


def _joined_paths(text: str) -> str:
    """Paths that follow one another and look the same as one path."""
    return re.sub(r"(?:<path d=\"[^\"]*\"( [^>]*)/>\n)(?:<path d=\"[^\"]*\"\1/>\n)+", _joined, text)


def _joined(found: re.Match[str]) -> str:
    shapes = "".join(re.findall(r" d=\"([^\"]*)\"", found[0]))
    return f'<path d="{shapes}"{found[1]}/>\n'


def _font(found: re.Match[str]) -> str:
    weight = f"font-weight: {found[1]}; " if found[1] else ""
    return f"{weight}font-size: {found[2]}"


def _short(found: re.Match[str]) -> str:
    value = float(found[0])
    text = f"{value:.{1 if abs(value) >= 10.0 else 2}f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text


def _attribute(text: str) -> str:
    return text.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")


def svg(figure: Figure) -> str:
    """A figure as an SVG element, the same bytes for the same figure."""
    from matplotlib import rc_context

    stream = io.StringIO()
    with rc_context({"svg.hashsalt": "pilotid", "svg.fonttype": "none"}):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]
