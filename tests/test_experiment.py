"""What follows from fits: contrasts, effects, what does not count, tables, figures."""

from __future__ import annotations

import math
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from pandas import DataFrame, Series, concat
from scipy.stats import ttest_rel, wilcoxon
from statsmodels.stats.anova import AnovaRM
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.power import TTestPower

from pilotid.estimate.quantities import SYMBOLS, symbol
from pilotid.experiment import report
from pilotid.experiment.comparisons import (
    anova,
    holm,
    paired,
    planned,
    sensitivity,
    subjects_needed,
)
from pilotid.experiment.figures import figures, means_figure, responses_figure
from pilotid.experiment.files import Part, pairs_of, with_factors
from pilotid.experiment.fits import beside_others
from pilotid.experiment.report import first_contrasts, left_out_table, means_tables, tables_tex
from pilotid.experiment.results import Fitting, Results, Settings, choices_of
from pilotid.likelihood.choice import Candidate
from pilotid.model.catalogue import MODELS
from pilotid.support.types import InputError

A = (1.1, 1.4, 0.9, 2.0, 1.3)
B = (1.6, 1.5, 1.7, 2.1, 2.2)
C = (0.6, 1.2, 0.4, 1.9, 1.0)
TEXT = "dynamics=C1,C4:gain;C2,C5:single;C3,C6:double;motion=C1,C2,C3:off;C4,C5,C6:on"
CONDITIONS = ("C1", "C2", "C3", "C4", "C5", "C6")
#: What differs from a sound estimate, by subject and condition.
Faults = Mapping[tuple[str, str], Mapping[str, object]]


def parts_of(conditions: Sequence[str], subjects: int = 5, **fields: str) -> list[Part]:
    return [
        Part(
            (Path(f"s{s}_{c}.mat"),),
            {"subject": str(s), "condition": c, **fields},
        )
        for s, c in product(range(1, subjects + 1), conditions)
    ]


def made(
    columns: Mapping[str, Sequence[float]],
    faults: Faults | None = None,
    *,
    key: str = "tlead",
    pairs: Sequence[tuple[str, str]] = (),
    factors: str | None = None,
    keep_all: bool = False,
) -> Results:
    """Results of one named model whose estimates are given by condition and subject."""
    parts = parts_of([*columns], len(next(iter(columns.values()))))
    parts, levels = with_factors(parts, factors)
    models = {"single": MODELS["single"]}
    settings = Settings(
        Fitting({}), models, ["single"], pairs=pairs, factors=levels, keep_all=keep_all
    )
    empty = {"rows": [], "candidates": [asdict(Candidate("single", 5))]}
    looks, fits = {}, []
    for part in parts:
        subject, condition = part.fields["subject"], part.condition
        own = dict((faults or {}).get((subject, condition), {}))
        value = columns[condition][int(subject) - 1]
        looks[part] = {**empty, "runs": 1, "remarks": own.get("recording", [])}
        row = {
            "kind": "parameter", "parameter": key, "unit": "s", "value": value, "std_error": 0.1,
            "lower_95": value - 0.2, "upper_95": value + 0.2, "determined": "why" not in own,
            "left_out": own.get("why", ""), "otherwise": "", "run": None, "model": "single",
            "method": "mle", "element": "", "outcome": "converged", "usable": True, "vaf": 90.0,
            "of_fit": [], "of_loops": [], "failure": "", **own,
        }  # fmt: skip
        other = {**row, "otherwise": "band", "value": value + 0.05}
        if "absent" not in own:
            fits.append((part, {**empty, "rows": [row, other]}))
    return Results(settings, looks, *choices_of(looks, settings), fits, ())


def test_a_contrast_is_the_paired_t_test() -> None:
    (found,) = made({"C1": A, "C2": B}).contrasts.to_dict("records")
    known = ttest_rel(B, A)
    assert (found["condition_a"], found["condition_b"], found["subjects"]) == ("C1", "C2", 5)
    p = found["p_holm"]
    assert (found["t"], found["freedom"], p) == pytest.approx((known.statistic, 4, known.pvalue))
    low, high = known.confidence_interval(0.95)
    assert (found["lower_95"], found["upper_95"]) == pytest.approx((low, high))
    assert found["wilcoxon_p"] == wilcoxon(np.subtract(B, A)).pvalue
    assert found["notes"] == ""
    assert next(report.summary(made({"C1": A, "C2": B}))).endswith("Holm, first tlead of C1:C2.")


def test_pairs_are_all_or_those_that_differ_in_one_factor_or_those_named() -> None:
    columns = {c: [v + k for v in A] for k, c in enumerate(CONDITIONS)}
    rng = np.random.default_rng(1)
    columns = {c: (np.array(own) + rng.normal(size=5)).tolist() for c, own in columns.items()}
    assert len(made(columns).contrasts) == 15
    found = made(columns, factors=TEXT).contrasts
    assert len(found) == 9
    assert ("C1", "C6") not in {*zip(found["condition_a"], found["condition_b"], strict=True)}
    corrected = multipletests(found["p"], method="holm")[1]
    assert found["p_holm"].to_numpy() == pytest.approx(corrected)
    (own,) = made(columns, pairs=[("C3", "C1")]).contrasts.to_dict("records")
    assert own["difference"] == pytest.approx(np.mean(columns["C1"]) - np.mean(columns["C3"]))


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        ({"why": "at its bound"}, "tlead at its bound"),
        ({"why": "not determined"}, "tlead not determined"),
        ({"usable": False, "outcome": "died"}, "tlead died"),
        ({"of_fit": [("little-explained", "a", "wrong")]}, "tlead little-explained"),
        ({"of_loops": [("misspecified", "a", "wrong")]}, "tlead misspecified"),
        ({"recording": [("lost-samples", "a", "wrong")]}, "tlead lost-samples"),
        ({"absent": True}, "no recording"),
    ],
)
def test_what_does_not_count(fault: Mapping[str, object], why: str) -> None:
    faults = {("4", "C2"): fault}
    results = made({"C1": A, "C2": B}, faults)
    (found,) = results.contrasts.to_dict("records")
    assert found["notes"] == f"n = 4 of 5: subject 4, {why} in C2"
    keep = [0, 1, 2, 4]
    known = ttest_rel(np.array(B)[keep], np.array(A)[keep])
    assert found["t"] == pytest.approx(known.statistic)
    kept = made({"C1": A, "C2": B}, faults, keep_all=True).contrasts["subjects"].item()
    assert kept == (4 if "usable" in fault or "absent" in fault else 5)
    (table,) = means_tables(results)
    assert ("n = 4" in table.rows[0][3]) == ("absent" not in fault)


def test_a_parameter_that_runs_away_in_one_subject_of_nine_moves_no_mean() -> None:
    """Over 200 experiments the mean is within 1 of its errors as often as Student's t says."""
    rng, inside = np.random.default_rng(5), []
    for _ in range(200):
        before, after = 1.0 + 0.2 * rng.normal(size=(2, 9)) + [[0.0], [0.5]]
        after[3] = 94.5
        columns = {"C1": before.tolist(), "C2": after.tolist()}
        (own,) = made(columns, {("4", "C2"): {"why": "not determined"}}).contrasts.to_dict(
            "records"
        )
        inside.append(abs(own["difference"] - 0.5) < own["std_error"])
    assert np.mean(inside) == pytest.approx(0.653, abs=3.0 * np.sqrt(0.653 * 0.347 / 200))


def test_what_cannot_be_tested_is_a_row_that_says_so() -> None:
    (same,) = made({"C1": (0.1, 0.2, 0.3), "C2": (0.4, 0.5, 0.6)}).contrasts.to_dict("records")
    assert same["std_error"] == pytest.approx(0.0, abs=1e-15)
    assert math.isnan(same["t"])
    (one,) = made({"C1": A[:1], "C2": B[:1]}).contrasts.to_dict("records")
    assert (one["subjects"], one["difference"]) == (1, 0.5)


@pytest.mark.parametrize("text", ["C1:C7", "C1:C1", "tlead:C1", "C1:", "C1:C2:C3"])
def test_senseless_pairs_are_refused(text: str) -> None:
    assert pairs_of(["C1:C2"], ["C2", "C1"]) == [("C1", "C2")]
    with pytest.raises(InputError, match=f"--contrast {text}"):
        pairs_of(["C1:C2", text], ["C1", "C2"])


def test_holm_and_effect_size_by_hand() -> None:
    assert holm(Series([0.01, 0.04, 0.03, 0.005])).to_numpy() == pytest.approx(
        [0.03, 0.06, 0.06, 0.02]
    )
    corrected = holm(Series([0.02, math.nan, 0.01])).to_numpy()
    assert corrected[0::2] == pytest.approx([0.02, 0.02])
    assert math.isnan(corrected[1])
    # Hedges' J(2) = gamma(1) / (1 * gamma(.5)).
    own = paired(Series(np.zeros(3)), Series([-2.0, 2.0, 6.0]))
    assert own["effect_size"] == pytest.approx(0.5 / math.sqrt(math.pi))
    own = paired(Series(np.zeros(6)), Series([0.9, 1.1, 1.0, 1.2, 0.8, 30.0]))
    assert 0.9 < own["robust_difference"] < 1.3


def test_effects_are_those_of_statsmodels_and_epsilon_is_boxs() -> None:
    rng = np.random.default_rng(2)
    effect = np.array([0.0, 0.5, 1.5, 0.2, 1.2, 2.9])
    values = effect + rng.normal(size=(7, 1)) + rng.normal(size=(7, 6)) * [1, 2, 1, 1, 3, 1]
    found = made(dict(zip(CONDITIONS, values.T.tolist(), strict=True)), factors=TEXT).factors
    cells = [(s, *cell) for s, *cell in product(range(7), ("off", "on"), "abc")]
    frame = DataFrame(cells, columns=["person", "motion", "dynamics"]).assign(value=values.ravel())
    known = AnovaRM(frame, "value", "person", ["dynamics", "motion"]).fit().anova_table
    assert list(found["effect"]) == list(known.index)
    assert found[["F", "df1", "df2", "p"]].to_numpy(float) == pytest.approx(
        known[["F Value", "Num DF", "Den DF", "Pr > F"]].to_numpy()
    )
    covariance = np.cov(values[:, 3:] - values[:, :3], rowvar=False)
    centre = np.eye(3) - 1.0 / 3.0
    box = centre @ covariance @ centre
    own = found.set_index("effect")["epsilon"]
    assert own["dynamics:motion"] == pytest.approx(np.trace(box) ** 2 / (2.0 * np.sum(box**2)))
    assert own["motion"] == pytest.approx(1.0)
    # Winer, Statistical Principles in Experimental Design (1962), the drugs of table 4.3-1.
    drugs = np.array([[30, 28, 16, 34], [14, 18, 10, 22], [24, 20, 18, 30], [38, 34, 20, 44],
                      [26, 28, 14, 30.0]])  # fmt: skip
    assert anova(drugs, ["drug"])["drug"]["F"] == pytest.approx(24.76, abs=0.005)
    assert anova(np.ones((3, 2)), ["none"]) == {}


def test_factors_take_whole_subjects_and_are_not_tested_on_few() -> None:
    columns = {c: [v + k * v for v in A] for k, c in enumerate(CONDITIONS)}
    one = made(columns, {("3", "C5"): {"why": "not determined"}}, factors=TEXT).factors
    assert {*one["subjects"]} == {4}
    assert one["notes"].str.contains("subject 3, tlead not determined in C5").all()
    out = {(s, "C5"): {"why": "not determined"} for s in "345"}
    (few,) = made(columns, out, factors=TEXT).factors.to_dict("records")
    assert math.isnan(few["F"])
    assert few["notes"].startswith("not tested")


def test_factors_are_fields_of_the_pattern() -> None:
    files = [
        Part((Path(f"{s}{m}{d}"),), {"subject": s, "motion": m, "d": d})
        for s, m, d in product("12", ("off", "on"), "ab")
    ]
    parts, levels = with_factors(files, "motion,d")
    assert {part.condition for part in parts} == {"off, a", "off, b", "on, a", "on, b"}
    assert levels.loc["on, a"].to_dict() == {"motion": "on", "d": "a"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "each combination"),
        ("motion", "must be FACTOR"),
        ("motion=:off;C2:on", "must be FACTOR"),
        ("motion=C1:off;C9:on", "C9"),
        ("motion=C1,C2:off", "two levels"),
        ("motion=C1,C3:off;C2,C4:on;gain=C1,C2:low;C3:high", "each combination"),
    ],
)
def test_factors_that_make_no_sense_are_refused(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        with_factors(parts_of(CONDITIONS), text)


def test_subjects_needed_are_those_of_the_noncentral_t() -> None:
    for effect in (0.3, 0.5, 1.0):
        known = TTestPower().solve_power(effect, alpha=0.05, power=0.8)
        assert subjects_needed(effect) == math.ceil(known)
    assert subjects_needed(1e-3) is None
    own = planned(made({"C1": A, "C2": B}).contrasts, []).to_dict("records")[0]
    spread = 100.0 * np.std(np.subtract(B, A), ddof=1) / np.mean([A, B])
    assert own["spread"] == pytest.approx(spread)
    assert own["subjects"] == subjects_needed(15.0 / spread)


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="there is no pdflatex")
def test_every_table_compiles(tmp_path: Path) -> None:
    for key in (*SYMBOLS, r"50%_$x$ {\bad} #1 ^2 ~ <&>|"):
        text = tables_tex(made({"C_1 & 50 %": A, "C#2^~": B}, key=key))
        (tmp_path / "tables.tex").write_text(text, encoding="utf-8")
    (tmp_path / "paper.tex").write_text(
        r"\documentclass{article}\usepackage{booktabs,longtable}\begin{document}\input{tables}\end{document}"
    )
    command = ["pdflatex", "-halt-on-error", "-interaction=nonstopmode", "paper.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout.decode(errors="replace")[-2000:]


def test_tables_for_papers_have_means_differences_and_effects() -> None:
    columns = {c: [v + k * v for v in A] for k, c in enumerate(CONDITIONS)}
    text = tables_tex(made(columns, factors=TEXT))
    assert text.count(r"\begin{longtable}") == 3
    assert "$T_L$ & s & $1.34$ ($0.42$)" in text
    assert "motion & $5$" in text
    assert len(first_contrasts(made({"C1": A, "C2": B}), ("p",)).rows) == 1


def test_figures_hold_what_counts() -> None:
    results = made({"C1": A, "C2": B, "C3": C}, {("4", "C2"): {"why": "not determined"}})
    assert [figure.name for figure in figures(results)] == ["estimates-1"]
    ((_, own),) = results.groups()
    drawn = means_figure(own[own["left_out"] == ""]).axes[0]
    assert [len(line.get_xdata()) for line in drawn.get_lines() if line.get_marker() == "."] == [14]
    kept = [value for place, value in enumerate(B) if place != 3]
    heights = [patch.get_height() for patch in drawn.patches]
    assert heights == pytest.approx([np.mean(A), np.mean(kept), np.mean(C)])
    more = own[own["subject"] != "1"].assign(parameter="tlag")
    assert len(means_figure(concat([own, more])).axes) == 2
    rows = [
        (f"var_e{part}", c, s, "deg^2", scale * (1.0 + 0.1 * s), "")
        for part, scale in (("", 3.0), ("_target", 1.0), ("_remnant", 2.0))
        for c, s in product(("C1", "C2"), range(3))
    ]
    frame = DataFrame(
        rows, columns=["parameter", "condition", "subject", "unit", "value", "left_out"]
    )
    (bars,) = means_figure(frame).axes
    assert sum(patch.get_height() for patch in bars.patches) == pytest.approx(2 * 3.3)


def test_a_coefficient_that_is_poorly_known_weighs_little() -> None:
    rows = [("C1", "visual", w, 1.0 + 0.1 * s, 0.0, 0.1) for w, s in product((0.5, 5.0), range(4))]
    rows.append(("C1", "visual", 5.0, 40.0, 0.0, 30.0))
    columns = ["condition", "channel", "omega", "real", "imag", "std"]
    drawn = responses_figure(DataFrame(rows, columns=columns))
    line = next(own for own in drawn.axes[0].get_lines() if own.get_marker() == "o")
    assert np.asarray(line.get_ydata()) == pytest.approx([1.15, 1.15], abs=0.1)


def test_every_parameter_of_the_catalogue_has_a_symbol() -> None:
    keys = {key for model in MODELS.values() if not model.changes for key in model.keys}
    assert {key for key in keys if not symbol(key).startswith("$")} == set()
    names = ("Kvis", "tlead2", "Kvis*tlead", "var_e_target", "own_gain", "")
    shown = ("$K_v$", "$T_{L,2}$", r"$K_v\,T_L$", r"$\sigma^2_{e,t}$", "own_gain", "")
    assert tuple(map(symbol, names)) == shown


def test_shifts_are_in_claimed_errors_of_estimates_that_count() -> None:
    rows = made({"C1": A}, {("2", "C1"): {"why": "at its bound"}}).quantities
    table = sensitivity(rows, [])
    assert table.to_dict("records") == [
        {"condition": "C1", "otherwise": "band", "method": "mle", "tlead": pytest.approx(0.5)}
    ]


def test_a_recording_in_another_unit_than_those_beside_it_is_wrong() -> None:
    sizes = {"1": 1.0, "2": 1.7, "3": 0.0175, "4": 0.8}
    looks = {
        Part((Path(subject),), {"subject": subject, "condition": "A"}): {
            "rows": [{"parameter": "rms_x", "run": None, "value": size}],
            "fingerprints": [],
        }
        for subject, size in sizes.items()
    }
    ((part, remark),) = beside_others(looks)
    assert (part.fields["subject"], remark.code, remark.grade) == ("3", "wrong-unit", "wrong")
    assert not [*beside_others(dict([*looks.items()][1:3]))]


def left_out(method: str, likelihoods: list[float], vaf: float = 80.0) -> DataFrame:
    known = {"condition": "C1", "file": "a", "run": [1, 2, 3], "model": "single", "method": method}
    return DataFrame({**known, "vaf": vaf, "log_likelihood": likelihoods})


def test_runs_left_out_are_set_against_the_best_that_predicts_them() -> None:
    lost = left_out("lost", [math.nan] * 3, math.nan)
    good, bad = left_out("good", [101.0, 102.0, 103.0]), left_out("bad", [97.0] * 3)
    results = made({"C1": A, "C2": B})
    object.__setattr__(results, "left_out", concat([good, bad, lost]))
    table = left_out_table(results)
    rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    assert [row["method"] for row in rows] == ["good", "bad", "lost"]
    assert [row["predicted"] for row in rows] == ["3", "3", "0"]
    assert [row["behind mean"] for row in rows] == ["0", "-5.00", "-"]
