"""The report of a study, from stores that are written by hand."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from stores import failed, finish

from pilotid.datasets import SCENARIOS
from pilotid.report.study import overview, write_report
from pilotid.study.study import scenario_entry
from pilotid.study.table import Entry, Fit, Store, read_study
from pilotid.support.format import as_text, decimals, number, plus_minus, share, signed
from pilotid.support.store import Key

KEYS = ("Kvis", "tlead", "tdvis", "Kvest", "tdvest", "fnm", "dnm")
TRUTH = (0.17, 2.93, 0.32, 1.59, 0.29, 12.0, 0.3)
ALL = ("nominal", "single", "remnant-0.1", "remnant-0.8", "starts", "length-20", "someone's own")
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


def entry(name: str, position: int = 0) -> Entry:
    """A scenario of the catalogue, or one that has another name."""
    known = scenario_entry(SCENARIOS.get(name, SCENARIOS["nominal"]), position)
    return replace(known, name=name)


def fit(
    key: Key, values: Sequence[float], errors: Sequence[float], *, ok: bool = True,
    keys: Sequence[str] = KEYS, truth: Sequence[float] = TRUTH,
) -> Fit:  # fmt: skip
    rows = tuple(
        (k, "s" if k.startswith("t") else "", t, 0.05 * t, v, s, v - 1.96 * s, v + 1.96 * s)
        for k, t, v, s in zip(keys, truth, values, errors, strict=True)
    )
    outcome, posterior = "converged" if ok else "not-converged", key[1].startswith("bayes")
    model = "single" if len(keys) == 5 else "multi"
    ended = outcome, "", ok, 80.0, 5, 0.02, posterior
    return Fit(*key, *ended, model=model, estimates=rows)


def draw(store: Store, scenario: str, method: str, count: int, seed: int) -> None:
    """Estimates that scatter as the bound says, for a method that claims as much."""
    rng = np.random.default_rng(seed)
    chosen = [k not in ("Kvest", "tdvest") or scenario != "single" for k in KEYS]
    truth, keys = np.array(TRUTH)[chosen], np.array(KEYS)[chosen].tolist()
    bound = (0.05 * truth).tolist()
    for r in range(count):
        values = truth * (1.0 + 0.05 * rng.normal(size=truth.size))
        known = {"keys": keys, "truth": truth.tolist()}
        store.add(fit((scenario, method, r), values.tolist(), bound, **known))


def report(folder: Path, fill: Callable[[Store], None], methods: Sequence[str]) -> Made:
    folder.mkdir(exist_ok=True)
    with Store(folder, create=True) as store:
        if not store.about().get("seed"):
            store.describe({"seed": "7", "code": "abc123", "numpy": "2.0"})
            settings = {name: {"class": name, "setting": 1.0} for name in methods}
            store.enter(methods=[
                Entry(name, place, settings[name], typed=TYPED.get(name, ""))
                for place, name in enumerate(methods)
            ])  # fmt: skip
            fill(store)
        study = store.comparison()
        page = write_report(folder, study)
        _, losses, rankings = overview(study)
        terminal = as_text(*losses, *rankings)
    assert page == folder / "report.html"
    short = (folder / "report.md").read_text(encoding="utf-8")
    return Made(folder, page.read_text(encoding="utf-8"), plain(short), terminal)


def scenarios(
    *names: str, methods: Sequence[str], count: int = 12, seed: int = 1
) -> Callable[[Store], None]:
    def fill(store: Store) -> None:
        for position, name in enumerate(names):
            store.enter([entry(name, position)])
            for place, method in enumerate(methods):
                draw(store, name, method, count, seed + 100 * position + place)

    return fill


# ------------------------------------------------------------------------------ the numbers


@pytest.fixture(scope="module")
def by_hand(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Five fits of one parameter: 1.0, 1.2, 1.4, one not converged at 3.0, one crashed."""

    def fill(store: Store) -> None:
        store.enter([entry("nominal")])
        known = {"keys": ("Kvis",), "truth": (1.0,)}
        values = ((1.0, 0.1, True), (1.2, 0.2, True), (1.4, 0.15, True), (3.0, 0.1, False))
        for r, (value, error, ok) in enumerate(values):
            store.add(fit(("nominal", "mle", r), [value], [error], ok=ok, **known))
        lost = failed(fit(("nominal", "mle", 4), [1.0], [0.1], **known))
        store.add(replace(lost, message="LinAlgError: a | b\n<c>"))
        lost = replace(lost, method="fourier", outcome="not-applicable", message="needs a target")
        store.add(replace(lost, replication=0))

    return report(tmp_path_factory.mktemp("hand"), fill, ("mle", "fourier"))


def test_scores_are_those_worked_out_by_hand(by_hand: Made) -> None:
    every, row = read_study(by_hand.folder).scored("nominal", "mle").itertuples()
    assert (row.n, row.failures, row.recordings) == (3, 2, 5)
    assert (row.bias, row.bias_percent) == pytest.approx((0.2, 20.0))
    assert row.bias_se == pytest.approx(0.2 / np.sqrt(3.0))
    assert row.std == pytest.approx(0.2)
    # squares of the errors 0, .04, .16: mean 1/15, root .2582, over the bound .05 5.164
    assert row.rmse_over_bound == pytest.approx(5.164, abs=1e-3)
    assert row.mean_std_error == pytest.approx(0.15)
    # 1.0 and 1.2 +- .392 hold the truth, 1.4 +- .294 does not
    assert row.coverage_95 == pytest.approx(2 / 3)
    # widths .392, .784 and .588 + 40 * .106; two failures cost 2 each; over 4.676 * .05
    assert row.loss == pytest.approx((1.764 + 40 * 0.106 + 4.0) / 5 / 0.23378, rel=1e-4)
    assert every.seconds == pytest.approx(0.02)


def test_tables_show_the_same_numbers(by_hand: Made) -> None:
    for shown in (by_hand.terminal, by_hand.markdown):
        row = next(line for line in shown.splitlines() if re.match(r"(\| )?mle\b", line))
        assert re.search(r"8\.56 .*\b67 \(21-94\).* 2 of 5", row)
    assert re.search(r"^fourier +not", by_hand.terminal, re.M)


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


# ------------------------------------------------------------------------------- the report


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Made:
    methods = ("mmle3", "mle", "bayes", "someone-else")
    folder = tmp_path_factory.mktemp("full")

    return report(folder, scenarios(*ALL, methods=methods), methods)


@pytest.mark.long
def test_equal_stores_give_equal_bytes(full: Made) -> None:
    files = [full.folder / "report.md", *sorted((full.folder / "figures").iterdir())]
    before = [file.read_bytes() for file in files]
    again = report(full.folder, lambda store: None, ())
    assert again.html == full.html
    assert [file.read_bytes() for file in files] == before


@pytest.mark.parametrize("lost", [False, True])
def test_a_population_makes_a_report_even_if_nothing_succeeded(tmp_path: Path, lost: bool) -> None:
    if not lost:
        finish(tmp_path, 12).close()

    def fill(store: Store) -> None:
        store.enter([Entry("population-usual", 30, {"runs": [1]}, population=True)])
        for replication in range(2):
            store.add(Fit("population-usual", "mle", replication, "crashed", "why"))

    made = report(tmp_path, fill, ("mle",))
    assert ("2 of 2" in made.markdown) == lost
    assert not re.search(r"\b(nan|inf)\b", made.html.partition("<script>")[0], re.I)
