"""Codes and grades of remarks."""

from __future__ import annotations

import copy
import pickle
import re
from pathlib import Path

from pilotid.support.remarks import CODES, OTHER, Remark, codes_of, remark_of

ROOT = Path(__file__).parent.parent


def test_a_remark_is_its_sentence_with_a_code_and_a_grade_and_so_are_copies() -> None:
    assert Remark("drift", "u drifts").grade == CODES["drift"][0]
    assert Remark("drift", "u drifts", "note").grade == "note"
    remark = Remark("drift", "u drifts", "wrong")
    for other in (remark, copy.deepcopy(remark), pickle.loads(pickle.dumps(remark))):
        assert (other, other.code, other.grade) == ("u drifts", "drift", "wrong")


def test_plain_sentences_have_a_code_as_well() -> None:
    assert codes_of(["from a plug-in", Remark("drift", "u drifts")]) == [OTHER, "drift"]
    remark = remark_of("two\nlines")
    assert (remark, remark.code, remark.grade) == ("two lines", OTHER, "note")


def test_the_guide_has_cause_and_cure_of_every_code() -> None:
    page = (ROOT / "docs/guide/warnings.md").read_text("utf-8")
    rows = [re.split(r" \| ", line[2:-2]) for line in page.splitlines() if line.startswith("| `")]
    assert [row[0] for row in rows] == list(dict.fromkeys(row[0] for row in rows))
    assert {row[0].strip("`"): row[1] for row in rows} == {
        code: f"{grade}: {words}" for code, (grade, words) in CODES.items()
    }
    assert all(len(row) == 4 and row[2].endswith(".") and row[3].endswith(".") for row in rows)
