"""Whether a release can be tagged: versions, dates, citation and paper; `nox -s release` runs it.

    python tests/checks/release.py [--pdf paper.pdf]

Prints what is missing, a line each, and ends with status 1 if something is.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections.abc import Iterator
from datetime import date
from pathlib import Path

TREE = Path(__file__).parents[2]
#: What the Journal of Open Source Software asks for, and about how many words.
SECTIONS = ("Summary", "Statement of need", "State of the field", "References")
WORDS = (750, 1750)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pdf", type=Path, help="write the paper here")
    given = parser.parse_args()
    found = [*versions(), *citation(), *paper()]
    if given.pdf:
        typeset(given.pdf)
    sys.stdout.write("".join(f"{line}\n" for line in found))
    raise SystemExit(1 if found else 0)


def text(name: str) -> str:
    return (TREE / name).read_text(encoding="utf-8")


def version() -> str:
    (found,) = re.findall(r'(?m)^__version__ = "(.+)"$', text("src/pilotid/__init__.py"))
    return str(found)


def versions() -> Iterator[str]:
    """What is not dated, or dated otherwise; `test_reference.py` compares versions."""
    wanted = version()
    released = re.search(r"(?m)^date-released: ['\"]?([\d-]+)", text("CITATION.cff"))
    heading = re.search(
        rf"(?m)^## \[{re.escape(wanted)}\] - (\d{{4}}-\d\d-\d\d)$", text("CHANGELOG.md")
    )
    if heading is None:
        yield f"CHANGELOG.md: no heading '## [{wanted}] - YYYY-MM-DD'; date what is [Unreleased]"
        return
    if date.fromisoformat(heading[1]) > date.today():
        yield f"CHANGELOG.md: {wanted} is dated in the future"
    if released is None or released[1] != heading[1]:
        yield f"CITATION.cff: date-released is not {heading[1]}, the date in CHANGELOG.md"
    unreleased = re.search(r"(?ms)^## \[Unreleased\]$(.*?)(?=^## |\Z)", text("CHANGELOG.md"))
    if unreleased and "\n- " in unreleased[1]:
        yield f"CHANGELOG.md: [Unreleased] still has lines; put them below {wanted}"


def citation() -> Iterator[str]:
    """What is wrong with the citation file, as cffconvert says."""
    command = ["cffconvert", "--validate", "--infile", str(TREE / "CITATION.cff")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        yield f"CITATION.cff: {(done.stderr or done.stdout).strip().splitlines()[-1]}"


def paper() -> Iterator[str]:
    """What the paper lacks."""
    body = text("paper/paper.md").split("---\n", 2)[2]
    for section in SECTIONS:
        if f"# {section}\n" not in body:
            yield f"paper/paper.md: no section '{section}'"
    if not WORDS[0] <= len(body.split()) <= WORDS[1]:
        yield f"paper/paper.md: {len(body.split())} words, not {WORDS[0]} to {WORDS[1]}"
    known = set(re.findall(r"(?m)^@\w+\{(\w+),", text("paper/paper.bib")))
    cited = set(re.findall(r"@(\w+\d{4})", body))
    yield from (f"paper/paper.bib: lacks {key}" for key in sorted(cited - known))
    yield from (f"paper/paper.md: does not cite {key}" for key in sorted(known - cited))


def typeset(target: Path) -> None:
    """Write the paper as PDF, by pandoc and Typst, which need no LaTeX."""
    import pypandoc
    import typst

    source = target.with_suffix(".typ")
    options = ["--citeproc", "--standalone", f"--bibliography={TREE / 'paper/paper.bib'}"]
    made = pypandoc.convert_file(str(TREE / "paper/paper.md"), "typst", extra_args=options)
    source.write_text(made, encoding="utf-8")
    typst.compile(str(source), output=str(target))
    source.unlink()
    sys.stdout.write(f"{target}: {target.stat().st_size} bytes\n")


if __name__ == "__main__":
    main()
