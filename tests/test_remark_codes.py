"""Codes and grades of remarks."""

from __future__ import annotations

import copy
import pickle

from pilotid.remarks import CODES, OTHER, Remark, codes_of, remark_of


def test_a_remark_is_its_sentence_with_a_code_and_a_grade() -> None:
    remark = Remark("at-bound", "fnm is at its bound")
    assert remark == "fnm is at its bound"
    assert (remark.code, remark.grade) == ("at-bound", CODES["at-bound"][0])
    assert Remark("offset", "u has an offset", "note").grade == "note"


def test_code_and_grade_survive_copies_and_other_processes() -> None:
    remark = Remark("offset", "u has an offset", "wrong")
    for other in (copy.deepcopy(remark), pickle.loads(pickle.dumps(remark))):
        assert (other, other.code, other.grade) == (remark, "offset", "wrong")


def test_plain_sentences_have_a_code_as_well() -> None:
    assert codes_of(["from a plug-in", Remark("drift", "u drifts")]) == [OTHER, "drift"]
    remark = remark_of("two\nlines")
    assert (remark, remark.code, remark.grade) == ("two lines", OTHER, "note")


def test_codes_are_words_joined_by_hyphens() -> None:
    for code, (grade, words) in CODES.items():
        assert code.replace("-", "").isalpha()
        assert code.islower()
        assert grade in ("wrong", "doubt", "note")
        assert words
