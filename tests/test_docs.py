"""What the pages say is so: commands parse, links lead somewhere, examples run."""

from __future__ import annotations

import re
import shlex
from functools import cache
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
MADE = ("_build", "generated")  # by the build
PAGES = sorted(
    page for page in DOCS.rglob("*.md") if not set(page.relative_to(DOCS).parts) & set(MADE)
)
TEXTS = [*ROOT.glob("*.md"), ROOT / "paper/paper.md", *PAGES]
FENCE = re.compile(r"^(`{3,}|:{3,})(\S*)[^\n]*\n(.*?)^\1\s*$", flags=re.DOTALL | re.MULTILINE)
#: Fences that hold text instead of an example that is run, and the pages that need them.
SHOWN = {
    "text": {"guide/commands.md", "guide/start.md", "theory/posterior.md", "theory/pipeline.md"},
    "matlab": {"guide/matlab.md"},
}


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def without_code(text: str) -> str:
    """The sentences of a page, without code and formulas."""
    text = re.sub(r"\$\$.*?\$\$|\$[^$\n]+\$", "", FENCE.sub("", text), flags=re.DOTALL)
    return re.sub(r"`[^`\n]+`", "``", re.sub(r"(?m)^    .*$", "", text))


@cache
def commands() -> dict[str, Any]:
    from typer.main import get_command

    from pilotid.cli.main import app

    group: Any = get_command(app)
    return dict(group.commands)


def command_lines(text: str) -> list[str]:
    """What a reader would type: lines of code that begin with `pilotid`, without pipes."""
    code = [body for _, _, body in FENCE.findall(text)]
    code += re.findall(r"(?m)^    (.*)$", FENCE.sub("", text))
    lines = re.sub(r"\\\n\s*", " ", "\n".join(code)).splitlines()
    found = []
    for line in lines:
        typed = re.match(r"\s*!?(?:\S*/)?(pilotid [a-z].*)$", line)
        if typed:
            words = shlex.split(typed[1].replace(";", " ; "), comments=True)
            ends = [i for i, word in enumerate(words) if word in ("|", ";", "&&", ">", "||")]
            found.append(shlex.join(words[: min(ends, default=len(words))]))
    return found


LINES = [(name_of(page), line) for page in TEXTS for line in command_lines(page.read_text("utf-8"))]


def test_there_are_commands() -> None:
    assert {shlex.split(line)[1] for _, line in LINES} >= set(commands()) - {"list"}


def test_commands_parse() -> None:
    for page, line in LINES:
        _, name, *words = shlex.split(line)
        assert name in commands(), f"{page}: there is no command {name}"
        try:
            commands()[name].make_context(name, words, resilient_parsing=False)
        except Exception as error:  # of any kind: values of options are read by code of ours
            pytest.fail(f"{page}: {line}: {error}")


def test_commands_in_sentences_exist() -> None:
    for page in TEXTS:
        for typed in re.findall(r"`pilotid ([a-z][^`]*)`", without_fences(page)):
            name, *words = typed.split()
            assert name in commands(), f"{page}: there is no command {name}"
            known = {option for p in commands()[name].params for option in p.opts} | {"--help"}
            for word in words:
                if word.startswith("--"):
                    assert word.split("=")[0] in known, f"{page}: {name} has no {word}"


def without_fences(page: Path) -> str:
    return FENCE.sub("", page.read_text("utf-8"))


@cache
def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub and the site make them."""
    text = without_fences(page)
    headings = re.findall(r"(?m)^#+ (.+)$", text)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading) for heading in headings]
    slugs = {re.sub(r"[^\w\- ]", "", each.lower()).strip().replace(" ", "-") for each in plain}
    return slugs | set(re.findall(r"(?m)^\(([\w-]+)\)=$", text))


def test_links_lead_somewhere() -> None:
    link = re.compile(r"\]\(([^)\s]+)\)")
    links = [(p, t) for p in TEXTS for t in link.findall(without_code(p.read_text("utf-8")))]
    for page, target in links:
        path, _, anchor = target.partition("#")
        if re.match(r"[a-z]+:", target) or set(Path(path).parts) & set(MADE):
            continue  # outside, or made by the build, which says so if it is not there
        aim = (page.parent / path).resolve() if path else page
        assert aim.exists(), f"{name_of(page)}: {target} is not there"
        if anchor:
            assert anchor in anchors(aim), f"{name_of(page)}: {path} has no heading #{anchor}"


def test_examples_are_run() -> None:
    for page in PAGES:
        for _, kind, _ in FENCE.findall(page.read_text("utf-8")):
            name = page.relative_to(DOCS).as_posix()
            assert kind.startswith("{") or name in SHOWN.get(kind, ()), f"{name}: ```{kind}"


def test_the_pipeline_is_where_its_page_says() -> None:
    text = (DOCS / "theory/pipeline.md").read_text("utf-8")
    rows = re.findall(r"(?m)^\| \d+\. [^|]+\| `([\w/.]+)` \| ([^|]+) \|", text)
    assert len(rows) == 10
    for file, names in rows:
        code = (ROOT / "src/pilotid" / file).read_text("utf-8")
        for name in re.findall(r"`(\w+)`", names):
            assert re.search(rf"(?m)^(def|class) {name}\b", code), f"{file}: no {name}"
    drawn = {"prepare", "prediction", "band_likelihood", "likelihood", "search", "profile"}
    assert drawn <= {Path(file).stem for file, _ in rows}
    assert drawn <= set(re.findall(r"\w+", text.split("```")[1]))
    for file in re.findall(r"`((?:solve|spectral|likelihood)/\w+\.py)`", text):
        assert (ROOT / "src/pilotid" / file).exists(), file
