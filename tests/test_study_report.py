"""The report of a study, from stores that are written by hand."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers import written

from pilotid.report.study import overview
from pilotid.study.comparison import MethodResults, comparison_of
from pilotid.study.store import MethodEntry, ParameterTruth, Result, ScenarioEntry, Store, Unit
from pilotid.support.document import table_rich
from pilotid.support.escaping import for_html
from pilotid.support.numbers import decimals, number, plus_minus, share, signed
from pilotid.support.terminal import make_console

KEYS = ("Kvis", "tlead", "tdvis", "Kvest", "tdvest", "fnm", "dnm")
TRUTH = (0.17, 2.93, 0.32, 1.59, 0.29, 12.0, 0.3)
MULTI = tuple(
    ParameterTruth(k, "s" if k.startswith("t") else "", t, 0.05 * t)
    for k, t in zip(KEYS, TRUTH, strict=True)
)
ALL = (
    "nominal",
    "single",
    "white-remnant",
    "disturbance-only",
    "target-only",
    "disturbance-step",
    "target-step",
    "remnant-0.1",
    "remnant-0.4",
    "remnant-0.8",
    "starts",
    "length-20",
    "length-164",
    "runs-2",
    "someone's own",
)


TYPED = {"someone-else": "their file.py:Own"}


@dataclass(frozen=True)
class Made:
    """A store and its report."""

    folder: Path
    html: str
    markdown: str
    terminal: str


def plain(text: str) -> str:
    """A text with hyphens for minus signs and dashes."""
    return text.replace("\N{MINUS SIGN}", "-").replace("\N{EN DASH}", "-")


def entry(
    name: str, position: int = 0, parameters: Sequence[ParameterTruth] = MULTI
) -> ScenarioEntry:
    length = float(name[7:]) if name.startswith("length-") else 81.92
    runs = int(name[5:]) if name.startswith("runs-") else 1
    level = float(name[8:]) if name.startswith("remnant-") else 0.4
    settings = {
        "class": "Scenario",
        "name": name,
        "remnant": {"class": "Remnant", "frequency": 3.5, "damping": 0.7, "level": level},
        "duration": length,
        "runs": runs,
        "one_recording": name == "starts",
        "start_spread": 0.4 if name == "starts" else 0.0,
    }
    family = name.partition("-")[0]
    family = family if family in ("length", "runs", "remnant") else ""
    model = "single" if name == "single" else "multi"
    own = (*parameters[:3], *parameters[5:]) if name == "single" else tuple(parameters)
    return ScenarioEntry(name, position, f"case {name}", model, settings, own, family)


def fit(
    unit: Unit, values: Sequence[float], errors: Sequence[float], *, ok: bool = True,
    posterior: bool = False, keys: Sequence[str] = KEYS,
) -> Result:  # fmt: skip
    rows = tuple(
        (key, v, s, v - 1.96 * s, v + 1.96 * s)
        for key, v, s in zip(keys, values, errors, strict=True)
    )
    outcome = "converged" if ok else "not-converged"
    return Result(unit, outcome, "", ok, 80.0, 5, posterior, 0.02, rows)


def draw(store: Store, entry: ScenarioEntry, method: str, count: int, seed: int) -> None:
    """Estimates that scatter as the bound says, for a method that claims as much."""
    rng = np.random.default_rng(seed)
    truth = np.array([p.truth for p in entry.parameters])
    bound = np.array([p.bound or 0.0 for p in entry.parameters])
    keys = [p.parameter for p in entry.parameters]
    for r in range(count):
        values = truth + bound * rng.normal(size=truth.size)
        unit = Unit(entry.name, method, r)
        posterior = method.startswith("bayes")
        store.add(fit(unit, values.tolist(), bound.tolist(), posterior=posterior, keys=keys))


def report(folder: Path, fill: Callable[[Store], None], methods: Sequence[str]) -> Made:
    folder.mkdir(exist_ok=True)
    with Store(folder, create=True) as store:
        if not store.about().get("seed"):
            store.describe({"seed": "7", "code": "abc123", "numpy": "2.0"})
            for position, name in enumerate(methods):
                settings = {"class": name, "setting": 1.0}
                store.add_method(MethodEntry(name, position, settings, typed=TYPED.get(name, "")))
            fill(store)
        study = comparison_of(store)
        page, whole = written(folder, study)
        console = make_console()
        with console.capture() as captured:
            for table in overview(study)[1]:
                console.print(table_rich(table))
    assert page == folder / "report.html"
    short = (folder / "report.md").read_text(encoding="utf-8")
    assert len(short) <= len(whole)
    return Made(folder, page.read_text(encoding="utf-8"), plain(whole), captured.get())


def scenarios(
    *names: str, methods: Sequence[str], count: int = 12, seed: int = 1
) -> Callable[[Store], None]:
    def fill(store: Store) -> None:
        for position, name in enumerate(names):
            own = entry(name, position)
            store.add_scenario(own)
            for place, method in enumerate(methods):
                draw(store, own, method, count, seed + 100 * position + place)

    return fill


def cell_of(folder: Path, scenario: str, method: str) -> MethodResults:
    with Store(folder) as store:
        cell = comparison_of(store).at(scenario, method)
    assert cell is not None
    return cell


# ------------------------------------------------------------------------------ the numbers


@pytest.fixture(scope="module")
def by_hand(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Five fits of one parameter: 1.0, 1.2, 1.4, one not converged at 3.0, one crashed."""

    def fill(store: Store) -> None:
        own = entry("nominal", parameters=(ParameterTruth("Kvis", "", 1.0, 0.1),))
        store.add_scenario(own)
        values = ((1.0, 0.1, True), (1.2, 0.2, True), (1.4, 0.15, True), (3.0, 0.1, False))
        for r, (value, error, ok) in enumerate(values):
            store.add(fit(Unit("nominal", "mle", r), [value], [error], ok=ok, keys=("Kvis",)))
        store.add(Result(Unit("nominal", "mle", 4), "crashed", "LinAlgError: a | b\n<c>"))
        refusal = "needs a target"
        store.add(Result(Unit("nominal", "fourier", 0), "not-applicable", refusal))

    return report(tmp_path_factory.mktemp("hand"), fill, ("mle", "fourier"))


def test_scores_are_those_worked_out_by_hand(by_hand: Made) -> None:
    cell = cell_of(by_hand.folder, "nominal", "mle")
    score = cell.percent[0]
    assert (score.n, score.failures, score.tried) == (3, 2, 5)
    assert score.bias == pytest.approx((20.0, 20.0 / np.sqrt(3.0)))
    assert score.std.value == pytest.approx(20.0)
    # squares of the errors 0, .04, .16: mean 1/15, root .2582, over the bound 2.582
    assert score.ratio.value == pytest.approx(2.582, abs=1e-3)
    assert score.claimed == pytest.approx(15.0)
    # 1.0 and 1.2 +- .392 hold the truth, 1.4 +- .294 does not
    assert score.coverage.value == pytest.approx(2 / 3)
    # widths .392, .784 and .588 + 40 * .106; two failures cost 2 each; over 4.676 * .1
    assert score.loss.value == pytest.approx((1.764 + 40 * 0.106 + 4.0) / 5 / 0.46756, rel=1e-4)
    assert cell.seconds == pytest.approx(0.02)


def test_tables_show_the_same_numbers(by_hand: Made) -> None:
    row = next(line for line in by_hand.markdown.splitlines() if line.startswith("| Kvis | mle |"))
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[2] == "3"
    assert float(cells[3].split()[0]) == pytest.approx(4.28, abs=0.01)
    assert cells[5:8] == ["2.58 ± 0.93", "67 (21-94)", "+20 ± 12"]
    assert re.search(r"^mle +4.28 .* 2 of 5", by_hand.terminal, re.M)
    assert re.search(r"^fourier +not", by_hand.terminal, re.M)


def test_failures_stand_with_their_reasons(by_hand: Made) -> None:
    text = by_hand.markdown
    assert "| nominal | mle | 1 | 5 | failure | failed: an error ended the fit | " in text
    assert r"LinAlgError: a \| b &lt;c>" in text
    assert "LinAlgError: a | b &lt;c&gt;" in by_hand.html
    assert "| nominal | mle | 1 | 5 | failure | did not converge within" in text
    assert "no try | not applicable to this recording | needs a target |" in text
    assert "`fourier`: not applicable by its own word" in text


def test_numbers_have_the_digits_that_their_error_allows() -> None:
    assert plus_minus(1.2345, 0.034) == "+1.234 ± 0.034"
    assert plain(plus_minus(-123.4, 12.0)) == "-123 ± 12"
    assert plus_minus(-0.001, 1.0) == "0.0 ± 1.0"
    assert plus_minus(5.0, float("nan")) == "5.00"
    assert [plain(number(x)) for x in (0.0, 1.0, -26.66, 1234.0, 1e7, float("nan"))] == [
        "0", "1.00", "-26.7", "1234", "1.0e+07", "-",
    ]  # fmt: skip
    assert [plain(signed(x)) for x in (-24.2, 3.14, 9.96)] == ["-24", "+3.1", "+10"]
    assert [decimals(x) for x in (0.0312, 1.2, 150.0, 1e-12)] == [3, 1, 0, 9]
    assert decimals(-0.5, digits=3, most=2) == 2
    assert plain(share(0.95, (0.9, 0.98))) == "95 (90-98)"


def test_marked_up_words_are_safe() -> None:
    assert for_html("**`a<b`** [n](#x-1) 5 %") == (
        '<strong><code>a&lt;b</code></strong> <a href="#x-1">n</a> 5&nbsp;%'
    )


# ------------------------------------------------------------------------------- the report


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Made:
    methods = ("mmle3", "mle", "bayes", "someone-else")
    folder = tmp_path_factory.mktemp("full")

    def fill(store: Store) -> None:
        scenarios(*ALL, methods=methods)(store)
        store.describe({"mixed": "code", "remnant ratio remnant-0.1": "0.0307"})

    return report(folder, fill, methods)


@pytest.mark.long
def test_equal_stores_give_equal_bytes(full: Made) -> None:
    files = [full.folder / "report.md", *sorted((full.folder / "figures").iterdir())]
    before = [file.read_bytes() for file in files]
    again = report(full.folder, lambda store: None, ())
    assert again.html == full.html
    assert [file.read_bytes() for file in files] == before


def test_every_scenario_has_its_numbers_and_how_to_get_them(full: Made) -> None:
    for name in ALL:
        assert f"`{name}`: all numbers" in full.markdown
    assert "--method 'mmle3,mle,bayes,their file.py:Own' --replications 12" in full.markdown
    assert "mixes results of different code or settings (code)" in full.markdown
    assert "Seed 7, code digest abc123" in full.markdown
    assert "bayes(setting=1)" in full.html


def test_the_first_screen_answers(full: Made) -> None:
    top = full.markdown.partition("**Loss**")[0]
    assert re.search(r"Over these 14 scenarios \*\*`[\w-]+` is best\*\*", top)
    assert re.search(r"On `nominal`, \*\*`[\w-]+` is best\*\* of \d+: loss \d\.\d\d", top)
    matrix = [line for line in top.splitlines() if line.startswith("| mle |")]
    assert len(matrix) == 2  # of all scenarios, and of the nominal one
    assert matrix[0].count("|") == 18


def test_the_start_that_methods_were_handed_is_told(full: Made) -> None:
    told = dict(re.findall(r"\| ([^|]+) \| case [^|]+ \| \w+ \| ([^|]+) \|", full.markdown))
    assert told.pop("starts") == "drawn within 40 % of the truth"
    assert set(told) == set(ALL) - {"starts"}
    assert set(told.values()) == {"of the model"}
    assert "No method is told the truth" in full.markdown


@pytest.mark.parametrize(
    ("name", "count"),
    [("nominal", 1), ("single", 11), ("target-step", 11), ("remnant-0.8", 1), ("starts", 1),
     ("runs-2", 11)],
)  # fmt: skip
def test_any_part_of_a_study_makes_a_report(tmp_path: Path, name: str, count: int) -> None:
    made = report(tmp_path, scenarios(name, methods=("mle",), count=count), ("mle", "never-run"))
    check_page(made.html)
    assert not re.search(r"\b(nan|inf)\b", made.html.partition("<script>")[0], re.I)


def test_an_empty_study_makes_a_report(tmp_path: Path) -> None:
    made = report(tmp_path, lambda store: store.add_scenario(entry("nominal")), ("mle",))
    assert "holds no fits yet" in made.html
    check_page(made.html)


def test_a_parameter_without_bound_or_with_nothing_claimed(tmp_path: Path) -> None:
    def fill(store: Store) -> None:
        own = entry("other", parameters=[ParameterTruth("a", "", 2.0, None)])
        store.add_scenario(own)
        for r in range(12):
            unit = Unit("other", "mle", r)
            row = (("a", 2.0 + 0.1 * r, None, None, None),)
            store.add(Result(unit, "converged", "", True, None, 0, False, None, row))

    made = report(tmp_path, fill, ("mle",))
    check_page(made.html)
    assert "gives no intervals" in made.markdown


def test_starts_that_end_together_are_counted(tmp_path: Path) -> None:
    def fill(store: Store) -> None:
        store.add_scenario(entry("starts"))
        for r in range(5):
            factor = 1.2 if r == 4 else 1.1 + 1e-4 * r
            values = [factor * t for t in TRUTH]
            store.add(fit(Unit("starts", "mle", r), values, [0.1] * 7))
        store.add(Result(Unit("starts", "mle", 5), "diverged"))

    made = report(tmp_path, fill, ("mle",))
    assert cell_of(tmp_path, "starts", "mle").agreeing == 4
    assert "| 4 of 6 |" in made.markdown


# --------------------------------------------------------------------------------- the page


class Page(HTMLParser):
    """Checks that tags close in order; collects ids and what the page refers to."""

    VOID = frozenset({"meta", "br", "link", "img", "hr"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        self.handle_attributes(attrs)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_attributes(attrs)

    def handle_attributes(self, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            if name in ("href", "src", "xlink:href", "srcset", "action"):
                self.links.append(value or "")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def check_page(html: str) -> Page:
    page = Page()
    page.feed(html)
    page.close()
    assert page.open == []
    assert len(set(page.ids)) == len(page.ids)
    inside = [link for link in page.links if not link.endswith(".csv")]
    assert all(link.startswith("#") and link[1:] in page.ids for link in inside)
    outside = re.findall(r"https?://[^\s\"'<)]+", html)
    assert set(outside) <= {"http://www.w3.org/1999/xlink", "http://www.w3.org/2000/svg"}
    return page


def test_the_page_is_well_formed_and_refers_to_nothing_outside(full: Made) -> None:
    page = check_page(full.html)
    assert {"summary", "nominal", "starts", "length-20", "provenance"} <= set(page.ids)
    assert len(full.html) < 1_200_000


def test_figures_are_xml_and_the_markdown_has_them_all(full: Made) -> None:
    files = sorted((full.folder / "figures").iterdir())
    for file in files:
        ElementTree.fromstring(file.read_text(encoding="utf-8"))
        assert f"(figures/{file.name})" in full.markdown
    short = (full.folder / "report.md").read_text(encoding="utf-8")
    assert short.count("![") == 1
    assert short.count("\n") < 150
    assert len(files) == full.html.count("<svg ") == full.markdown.count("![")
    assert re.search(r'class="dot" style="left:\d', full.html)


CHECK = """<script>addEventListener("load", () => {
  for (const part of document.querySelectorAll("details")) part.open = true;
  const drawn = [...document.querySelectorAll("svg")].filter(s => {
    const box = s.getBoundingClientRect(), inner = s.getBBox();
    return box.width > 0 && box.height > 0 && inner.width > 0 && inner.height > 0; });
  const table = document.querySelector("table"), button = table.querySelector("button");
  const first = () => table.tBodies[0].rows[0].cells[0].textContent;
  const before = first(); button.click(); const up = first(); button.click(); const down = first();
  const sorted = button.closest("th").getAttribute("aria-sort"); button.click();
  document.body.dataset.check = JSON.stringify([drawn.length, window.innerWidth,
    document.documentElement.scrollWidth, before, up, down, sorted, first(),
    performance.getEntriesByType("resource").length]); });</script>"""


@pytest.mark.parametrize("width", [1200, 390])
def test_a_browser_draws_the_page_and_asks_the_network_for_nothing(
    full: Made, tmp_path: Path, width: int
) -> None:
    browser = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chrome"))), None)
    if browser is None:
        pytest.skip("no Chromium on the PATH")
    page = tmp_path / "page.html"
    # A headless window is at least 500 wide, so that the page goes into a frame of its own width.
    html = re.sub("script-src [^;]*", "script-src 'unsafe-inline'", full.html)
    page.write_text(html.replace("</body>", CHECK + "</body>"), encoding="utf-8")
    frame = tmp_path / "frame.html"
    frame.write_text(
        f'<body style="margin:0"><iframe src="page.html" style="border:0;width:{width}px;'
        'height:800px"></iframe><script>addEventListener("load", () => setTimeout(() => {'
        "document.title = document.querySelector('iframe').contentDocument.body.dataset.check"
        "}, 200))</script>",
        encoding="utf-8",
    )
    done = subprocess.run(
        [browser, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr",
         "--v=0", "--allow-file-access-from-files", "--virtual-time-budget=5000",
         f"--window-size={max(width, 600)},900", f"--user-data-dir={tmp_path / 'profile'}",
         "--dump-dom", frame.as_uri()],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    assert "CONSOLE" not in done.stderr
    found = re.search(r"<title>\[(.*)\]</title>", done.stdout)
    assert found, done.stdout[:300]
    drawn, inside, across, before, up, down, order, last, requests = found[1].split(",")
    assert int(drawn) == full.html.count("<svg ")
    assert int(inside) == width
    assert int(across) <= width
    assert (up, down) == ('"bayes"', '"someone-else"')
    assert before == last
    assert order == '"descending"'
    assert requests == "0"
