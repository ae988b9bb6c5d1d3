"""Pages over several studies: what they hold, that they need no network, and their bytes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from stores import KEYS, finish, fit

from pilotid.publishing.changes import names_for
from pilotid.publishing.pages import publish
from pilotid.study.entries import MethodEntry, ParameterTruth, ScenarioEntry, Unit
from pilotid.study.store import Store
from pilotid.types import InputError

REPLICATIONS = 12


def with_plugin(folder: Path, truths: Sequence[float] = (1.5, 9.0)) -> None:
    """Two of the scenarios of `finish`, one of them of another truth; a method not installed."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(9)
    with Store(folder, create=True) as store:
        store.describe({"seed": "1", "code": "c0de", "numpy": "2.0"})
        for position, truth in enumerate(truths):
            known = tuple(ParameterTruth(key, "s", truth, 0.1) for key in KEYS)
            settings = {"class": "Scenario", "truth": [1.5] * 5, "remnant": {"level": 0.4}}
            name = ("first", "second")[position]
            store.add_scenario(ScenarioEntry(name, position, "words", "single", settings, known))
        store.add_method(MethodEntry("mle", 0, {"class": "mle", "memory": 2.0}))
        store.add_method(MethodEntry("wls", 40, {"class": "WLS"}, "d1ge57", "mine.wls:WLS"))
        for replication in range(REPLICATIONS):
            for scenario in ("first", "second")[: len(truths)]:
                for method in ("mle", "wls"):
                    store.add(fit(Unit(scenario, method, replication), rng))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pages over two stores."""
    folder = tmp_path_factory.mktemp("studies")
    (folder / "usual").mkdir()
    finish(folder / "usual", REPLICATIONS).close()
    with_plugin(folder / "mine")
    assert publish([folder / "usual", folder / "mine"], folder / "site").name == "index.html"
    return folder / "site"


class Page(HTMLParser):
    """Links, what is loaded, and rows of tables of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.rows: list[list[str]] = []
        self.ids: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        held = {name: value or "" for name, value in attrs}
        self.ids |= {held["id"]} if "id" in held else set()
        if tag == "a":
            self.links.append(held["href"])
        elif tag in ("script", "img", "link", "iframe", "object"):
            self.loaded += [held[name] for name in ("src", "href", "data") if name in held]
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_data(self, data: str) -> None:
        if self.rows and self.rows[-1]:
            self.rows[-1][-1] += data.strip()


def test_the_first_page_has_methods_of_both_studies_side_by_side(site: Path) -> None:
    rows = Page(site / "index.html").rows
    told = [tuple(row[:3]) for row in rows if row and row[0] in ("first", "second", "any")]
    overview = set(told[: 3 * 3 + 2 * 2])
    assert ("first", "mle", "usual") in overview
    assert ("first", "mle", "mine") in overview
    assert ("first", "wls", "mine") in overview
    text = (site / "index.html").read_text(encoding="utf-8")
    assert "of its own, digest d1ge57" in text
    assert "<code>mine.wls:WLS</code>" in text
    assert text.count('class="dot"') == 3 * 3 + 2 * 2


def test_every_link_leads_somewhere_and_nothing_is_loaded(site: Path) -> None:
    pages = {path: Page(path) for path in site.rglob("*.html")}
    assert len(pages) == 1 + 2 + 4
    for path, page in pages.items():
        assert not page.loaded
        assert page.links
        for link in page.links:
            name, _, anchor = link.partition("#")
            target = (path.parent / name).resolve() if name else path
            assert target.is_file(), f"{path.name}: {link}"
            assert not anchor or anchor in pages[target].ids
        text = path.read_text(encoding="utf-8")
        assert not re.findall(r"(?:src|href)=\"https?:|url\((?!#)|@import", text)


def test_scenarios_of_another_truth_have_pages_of_their_own(site: Path) -> None:
    names = {path.name for path in (site / "scenarios").glob("*.html")}
    assert names == {"first.html", "second.html", "second-2.html", "any.html"}
    together = (site / "scenarios" / "first.html").read_text(encoding="utf-8")
    assert "mle, usual" in together
    assert "mle, mine" in together
    assert "wls, mine" in together
    apart = (site / "scenarios" / "second-2.html").read_text(encoding="utf-8")
    assert "usual" not in apart
    figures = {path.name for path in (site / "scenarios" / "figures").iterdir()}
    assert {"errors-first.svg", "errors-first.pdf", "coverage-any.pdf"} <= figures


def test_rows_and_figures_can_be_taken_along(site: Path) -> None:
    assert (site / "scores.csv").read_text().startswith("study,scenario,method,parameter,")
    for name in ("usual", "mine"):
        assert {"estimates.csv", "summary.csv"} <= {p.name for p in (site / name).iterdir()}
        pictures = list((site / name / "figures").iterdir())
        kinds = [{p.stem for p in pictures if p.suffix == kind} for kind in (".svg", ".pdf")]
        assert kinds[0] == kinds[1] != set()


@pytest.mark.long
def test_equal_stores_give_equal_bytes(tmp_path: Path) -> None:
    with_plugin(tmp_path / "studies" / "mine", truths=(1.5,))
    for name in ("once", "twice"):
        publish([tmp_path / "studies" / "mine"], tmp_path / name)
    for path in (tmp_path / "once").rglob("*"):
        other = tmp_path / "twice" / path.relative_to(tmp_path / "once")
        assert path.is_dir() or path.read_bytes() == other.read_bytes()


def test_pages_are_not_written_over_a_study(tmp_path: Path) -> None:
    with_plugin(tmp_path / "mine", truths=(1.5,))
    for out in (tmp_path, tmp_path / "mine"):
        with pytest.raises(InputError, match="would be written over the study"):
            publish([tmp_path / "mine"], out)
    with pytest.raises(InputError, match="is named twice"):
        publish([tmp_path / "mine", tmp_path / "x" / ".." / "mine"], tmp_path / "site")
    with pytest.raises(InputError, match="there is no such file"):
        publish([tmp_path / "nothing"], tmp_path / "site")


def test_every_study_has_a_name_of_its_own() -> None:
    folders = [Path("a/run 1"), Path("b/run 1"), Path("c/scenarios"), Path("c/ä"), Path("c/..")]
    assert names_for(folders, ["scenarios"])[:4] == ["a-run-1", "b-run-1", "scenarios-2", "ä"]


def test_a_study_without_fits_has_a_page(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    Store(tmp_path / "empty", create=True).close()
    page = publish([tmp_path / "empty"], tmp_path / "site")
    assert "empty holds no fits yet" in page.read_text(encoding="utf-8")


def test_what_a_store_says_is_text(tmp_path: Path) -> None:
    folder = tmp_path / "bad"
    folder.mkdir()
    name = "<script>alert(1)</script>/../../x"
    rng = np.random.default_rng(1)
    known = tuple(ParameterTruth(key, "<b>", 1.5, 0.1) for key in KEYS)
    with Store(folder, create=True) as store:
        store.describe({"seed": "<i>"})
        store.add_scenario(ScenarioEntry(name, 0, "<u>", "single", {"class": "S"}, known))
        store.add_method(MethodEntry("<em>", 0, {"class": "<s>"}, "<q>", "<a href=x>"))
        for replication in range(3):
            store.add(fit(Unit(name, "<em>", replication), rng))
    publish([folder], tmp_path / "site")
    assert {p.parent for p in tmp_path.rglob("*.html")} == {
        tmp_path / "site",
        tmp_path / "site" / "bad",
        tmp_path / "site" / "scenarios",
    }
    for path in tmp_path.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"<(b|i|u|em|s|q)>|<script>alert|<a href=x>", text), path
