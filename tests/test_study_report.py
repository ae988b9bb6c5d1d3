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

from pilotid.numbers import decimals, number, plus_minus, printed, share, signed
from pilotid.report.content import inline_html
from pilotid.report.page import overview_table, write_report
from pilotid.report.rules import Rules, rules_for
from pilotid.report.verdicts import Grade, judge, sentence
from pilotid.study.comparison import Cell, comparison_of
from pilotid.study.entries import MethodEntry, ParameterTruth, Result, ScenarioEntry, Unit
from pilotid.study.store import Store
from pilotid.terminal import make_console

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
        page = write_report(folder, store, study)
        console = make_console()
        with console.capture() as captured:
            console.print(overview_table(study))
    assert page == folder / "report.html"
    markdown = plain((folder / "report.md").read_text(encoding="utf-8"))
    return Made(folder, page.read_text(encoding="utf-8"), markdown, captured.get())


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


def cell_of(folder: Path, scenario: str, method: str) -> Cell:
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
    assert (score.n, score.failures, score.tried, score.n_all) == (3, 2, 5, 4)
    assert score.bias == pytest.approx(20.0)
    assert score.std == pytest.approx(20.0)
    assert score.bias_se == pytest.approx(20.0 / np.sqrt(3.0))
    # squares of the errors 0, .04, .16: mean 1/15, root .2582, over the bound 2.582
    assert score.ratio == pytest.approx(2.582, abs=1e-3)
    assert score.claimed == pytest.approx(15.0)
    # 1.0 and 1.2 +- .392 hold the truth, 1.4 +- .294 does not, nor does 3.0; a crash is a miss.
    assert score.coverage == pytest.approx(2 / 3)
    assert score.coverage_all == pytest.approx(2 / 5)
    # mean of 1.0, 1.2, 1.4, 3.0 is 1.65
    assert score.bias_all == pytest.approx(65.0)
    assert cell.milliseconds == pytest.approx(20.0)


def test_tables_show_survivors_beside_all_runs(by_hand: Made) -> None:
    row = next(line for line in by_hand.markdown.splitlines() if line.startswith("| Kvis | mle |"))
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    # Fourth moment 2 * .2**4 / 3 is below .2**4: three fits tell no error of the std.  Squared
    # errors 0, .04, .16 deviate by .0833: rmse error .0833 / sqrt(3) / (2 * .258) over .1.
    assert cells == ["Kvis", "mle", "3", "2", "+20 ± 12", "20.0", "15.0", "10.0", "2.58 ± 0.93",
                     "67 (21-94)", "4", "+65 ± 46", "91.5", "40 (12-77)"]  # fmt: skip
    assert "**`mle`**: 3 of 5 fits count: too few for a verdict." in by_hand.markdown
    assert re.search(r"^mle +fails 40 %, 3 fits +2.0 \(Kvis \+20 %\) +3/5 ", by_hand.terminal, re.M)


def test_failures_stand_with_their_reasons(by_hand: Made) -> None:
    text = by_hand.markdown
    assert "| nominal | mle | 1 | 5 | failure | failed: an error ended the fit | " in text
    assert r"LinAlgError: a \| b &lt;c>" in text
    assert "LinAlgError: a | b &lt;c&gt;" in by_hand.html
    assert "| nominal | mle | 1 | 5 | failure | did not converge within" in text
    assert "no try | not applicable to this recording | needs a target |" in text
    assert "**`fourier`**: not applicable here (needs a target)." in text


def test_numbers_have_the_digits_that_their_error_allows() -> None:
    assert plus_minus(1.2345, 0.034) == "+1.234 ± 0.034"
    assert plain(plus_minus(-123.4, 12.0)) == "-123 ± 12"
    assert plus_minus(-0.001, 1.0) == "0.0 ± 1.0"
    assert plus_minus(5.0, float("nan")) == "5.00"
    assert [plain(number(x)) for x in (0.0, 1.0, -26.66, 1234.0, 1e7, float("nan"))] == [
        "0", "1.00", "-26.7", "1234", "1.0e+07", "-",
    ]  # fmt: skip
    assert plain(printed(-11.6)) == "-11.6"
    assert [plain(signed(x)) for x in (-24.2, 3.14, 9.96)] == ["-24", "+3.1", "+10"]
    assert [decimals(x) for x in (0.0312, 1.2, 150.0, 1e-12)] == [3, 1, 0, 9]
    assert decimals(-0.5, digits=3, most=2) == 2
    assert plain(share(0.95, (0.9, 0.98))) == "95 (90-98)"


def test_marked_up_words_are_safe() -> None:
    assert inline_html("**`a<b`** [n](#x-1) 5 %") == (
        '<strong><code>a&lt;b</code></strong> <a href="#x-1">n</a> 5&nbsp;%'
    )


# ----------------------------------------------------------------------------- the verdicts


def judged(
    tmp_path: Path, change: Callable[[np.ndarray, np.ndarray], None], count: int = 400
) -> str:
    """Verdict on fits whose values and claims are the bound's, but for a change."""
    rng = np.random.default_rng(3)
    values = np.array(TRUTH) * (1.0 + 0.05 * rng.normal(size=(count, 7)))
    errors = np.tile(0.05 * np.array(TRUTH), (count, 1))
    change(values, errors)

    with Store(tmp_path, create=True) as store:
        store.add_method(MethodEntry("mle", 0, {}))
        store.add_scenario(entry("nominal"))
        for r in range(count):
            store.add(fit(Unit("nominal", "mle", r), values[r].tolist(), errors[r].tolist()))
    cell = cell_of(tmp_path, "nominal", "mle")
    assert rules_for([cell]) == Rules(14)
    verdict = judge(cell, rules_for([cell]))
    return f"{verdict.grade.name} {verdict.words}: {sentence(verdict)}"


def nothing(values: np.ndarray, errors: np.ndarray) -> None:
    """No change."""


def test_an_honest_method_is_to_be_used(tmp_path: Path) -> None:
    words = judged(tmp_path, nothing)
    assert words.startswith("GOOD good: **`mle`**: use it. No bias that counts in any parameter")


def test_a_few_fits_leave_it_open(tmp_path: Path) -> None:
    words = judged(tmp_path, nothing, 30)
    told = re.match(
        r"OPEN open: needs about (\d+) recordings: \*\*`mle`\*\*: nothing against", words
    )
    assert told
    assert f"it takes about {told[1]} recordings to tell" in words
    assert int(told[1]) >= 60
    assert "open: Kvis, tlead, tdvis" in words


def test_a_bias_is_named(tmp_path: Path) -> None:
    def change(values: np.ndarray, errors: np.ndarray) -> None:
        values[:, 2] *= 1.06

    words = judged(tmp_path, change, 40)
    assert "PARTLY biased 1/7" in words
    assert "mind its bias in tdvis" in words
    assert re.search(r"Biased in tdvis \+[567]\.\d %", words)


def test_small_biases_do_not_count_however_sure(tmp_path: Path) -> None:
    def change(values: np.ndarray, errors: np.ndarray) -> None:
        values[:] = np.array(TRUTH) * (1.009 + 1e-4 * (values / np.array(TRUTH) - 1.0))

    assert judged(tmp_path, change).startswith("GOOD")


def test_too_small_claims_are_not_to_be_believed(tmp_path: Path) -> None:
    def change(values: np.ndarray, errors: np.ndarray) -> None:
        errors /= 4.0

    words = judged(tmp_path, change)
    assert "PARTLY narrow 7/7" in words
    assert "do not believe its intervals" in words


def test_a_method_that_mostly_fails_is_poor(tmp_path: Path) -> None:
    with Store(tmp_path, create=True) as store:
        store.add_method(MethodEntry("mle", 0, {}))
        store.add_scenario(entry("nominal"))
        for r in range(20):
            store.add(Result(Unit("nominal", "mle", r), "diverged"))
    verdict = judge(cell_of(tmp_path, "nominal", "mle"), Rules(0))
    assert verdict.grade is Grade.POOR
    assert "20 of 20 fits failed: do not use it here" in sentence(verdict)


# ------------------------------------------------------------------------------- the report


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Made:
    methods = ("mmle3", "mle", "bayes", "someone-else")
    folder = tmp_path_factory.mktemp("full")

    def fill(store: Store) -> None:
        scenarios(*ALL, methods=methods)(store)
        store.describe({"mixed": "code", "remnant ratio remnant-0.1": "0.0307"})

    return report(folder, fill, methods)


def test_equal_stores_give_equal_bytes(full: Made) -> None:
    files = [full.folder / "report.md", *sorted((full.folder / "figures").iterdir())]
    before = [file.read_bytes() for file in files]
    again = report(full.folder, lambda store: None, ())
    assert again.html == full.html
    assert [file.read_bytes() for file in files] == before


def test_the_papers_numbers_stand_beside_ours(full: Made) -> None:
    text = full.markdown
    assert re.search(r"\| Kvest \| mmle3 \| 12 \| 0 \| [^|]+ \| -11.6 \| [^|]+ \| 18 \|", text)
    assert re.search(r"\| disturbance \| tdvis \| \+406.72 \| [^|]+ \|", text)
    assert re.search(r"\| target step \| dnm \| -9.29 \|", text)
    assert re.search(r"\| Kvest \| mle \| 12 \| 0 \| [^|]+ \| [^|]+ \| -24 \|", text)  # Fig. 5
    assert "paper: bias&nbsp;%" in full.html


def test_every_scenario_has_its_numbers_and_how_to_get_them(full: Made) -> None:
    for name in ALL:
        assert name == "starts" or f"`{name}`: all numbers" in full.markdown
    assert "pilotid compare --scenario length-20,length-164 --method" not in full.markdown, (
        "nominal belongs to the lengths"
    )
    assert (
        "pilotid compare --scenario starts --method 'mmle3,mle,bayes,their file.py:Own' "
        "--replications 12 --seed 7 --out results/starts"
    ) in full.markdown
    assert "mixes results of different code or settings (code)" in full.markdown
    assert "| code digest | abc123 |" in full.markdown
    assert "bayes(setting=1)" in full.html
    assert "**inferred**" in full.markdown


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
    assert "no intervals" in made.markdown


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
    assert "| 4 of 6 | 10.0 |" in made.markdown


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
    assert all(link.startswith("#") and link[1:] in page.ids for link in page.links)
    outside = re.findall(r"https?://[^\s\"'<)]+", html)
    assert set(outside) <= {"http://www.w3.org/1999/xlink", "http://www.w3.org/2000/svg"}
    return page


def test_the_page_is_well_formed_and_refers_to_nothing_outside(full: Made) -> None:
    page = check_page(full.html)
    assert {"summary", "nominal", "starts", "remnant", "forcing", "length"} <= set(page.ids)
    assert len(full.html) < 1_000_000


def test_figures_are_xml_and_the_markdown_has_them_all(full: Made) -> None:
    files = sorted((full.folder / "figures").iterdir())
    for file in files:
        ElementTree.fromstring(file.read_text(encoding="utf-8"))
        assert f"(figures/{file.name})" in full.markdown
    assert len(files) == full.html.count("<svg ") == full.markdown.count("![")


CHECK = """<script>addEventListener("load", () => {
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
    page.write_text(full.html.replace("</body>", CHECK + "</body>"), encoding="utf-8")
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
    assert (before, up, down, last) == ('"mmle3"', '"bayes"', '"someone-else"', '"mmle3"')
    assert order == '"descending"'
    assert requests == "0"
