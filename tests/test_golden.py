"""No number moves: what the files in `golden` hold is computed again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from golden.golden import (
    FOLDER,
    KINDS,
    MEASURED,
    RECORDINGS,
    analysis,
    fits,
    machine,
    rows_of,
    summary,
    written_on,
)

HERE = machine() == written_on()
#: In claimed errors: elsewhere, sums are rounded in another order.
LARGEST_SHIFT = 1e-6 if HERE else 1e-3
#: The same where parameters are not told apart, so that the optimum is flat.
LARGEST_IF_FLAT = 1e-6 if HERE else 2e-2
#: Relative, where a table has no errors to measure by; and of what profiles give.
RELATIVE, RELATIVE_OF_ERRORS = (1e-9, 1e-9) if HERE else (1e-3, 2e-2)
ERRORS = ("std_error", "lower_95", "upper_95", "loss", "loss_lower", "loss_upper")
#: In claimed errors: elsewhere a search for an end comes as near to it by other steps.
LARGEST_SHIFT_OF_ENDS = LARGEST_SHIFT if HERE else 0.1


def table(numbers: str) -> np.ndarray:
    """Values, standard errors and interval ends, shape (parameters, 4)."""
    return np.array(numbers.split(), dtype=float).reshape(-1, 4)


@pytest.mark.numerical
@pytest.mark.parametrize(
    "number", [0, *(pytest.param(n, marks=pytest.mark.long) for n in range(1, RECORDINGS))]
)
@pytest.mark.parametrize("kind", KINDS)
def test_estimates_stay_where_they_were(kind: str, number: int) -> None:
    rows = rows_of(FOLDER / "estimates.csv")
    before = [r for r in rows if r["scenario"] == kind and r["recording"] == str(number)]
    moved = []
    for old, new in zip(before, fits(kind, [number]), strict=True):
        words = ("method", "outcome", "codes")
        shift, flat = np.inf, kind == "disturbance-only"
        # Elsewhere a search meets other optima where the likelihood is flat: intervals hold those.
        compared = 1 if flat and not HERE else 4
        if len(old["numbers"].split()) == len(new["numbers"].split()):
            was = table(old["numbers"])
            shifts = (table(new["numbers"]) - was)[:, :compared] / was[:, 1:2]
            shifts[:, 1:] *= LARGEST_SHIFT / LARGEST_SHIFT_OF_ENDS
            shift = np.max(np.abs(shifts), initial=0.0)
        if flat and old["method"] in ("mle", "mle-reference") and not HERE:
            continue  # rounding decides where they end
        # Whether another optimum is as likely is rounding's choice where the likelihood is flat.
        own, other = ([row[w] for w in words] for row in (old, new))
        if flat:
            own[-1], other[-1] = (" ".join(sorted({*r["codes"].split()})) for r in (old, new))
        if shift > (LARGEST_IF_FLAT if flat else LARGEST_SHIFT) or own != other:
            moved.append(f"{[old[w] for w in words]} {[new[w] for w in words]} {shift:.3g}")
    assert not moved, "\n".join(moved)


def require_equal(before: list[dict[str, str]], after: list[dict[str, str]]) -> None:
    """Refuse tables that differ in words, or in numbers by more than rounding."""
    for old, new in zip(before, after, strict=True):
        assert old.keys() <= new.keys()
        for key, was in old.items():
            allowed = RELATIVE_OF_ERRORS if key in ERRORS else RELATIVE
            try:
                assert float(new[key]) == pytest.approx(float(was), rel=allowed, abs=1e-12), key
            except ValueError:
                assert new[key] == was, key


@pytest.mark.long
def test_the_summary_of_a_study_stays(tmp_path: Path) -> None:
    require_equal(rows_of(FOLDER / "summary.csv"), summary(tmp_path / "study"))


@pytest.mark.long
@pytest.mark.skipif(not MEASURED, reason="PILOTID_MEASURED is not set")
def test_the_analysis_of_people_stays(tmp_path: Path) -> None:
    require_equal(rows_of(FOLDER / "analysis.csv"), analysis(MEASURED, tmp_path / "analysis"))
