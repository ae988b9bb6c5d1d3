"""The chapter on time, on numbers worked out by hand."""

from __future__ import annotations

import pytest

from pilotid.report.timing import ALIKE, Pace, _duration, _sentences


def made(method: str, milliseconds: float, rmse: float) -> Pace:
    return Pace(method, milliseconds, (milliseconds, milliseconds), rmse, (rmse, rmse))


def test_time_is_spared_by_what_is_faster_and_as_accurate() -> None:
    own = made("own", 100.0, 1.0)
    assert made("faster", 50.0, 1.0 + 0.9 * ALIKE).spares(own)
    assert not made("rougher", 50.0, 1.0 + 1.1 * ALIKE).spares(own)
    assert not made("slower", 200.0, 0.5).spares(own)
    assert not own.spares(own)


def test_sentences_name_what_is_worth_its_time_and_what_spares_the_rest() -> None:
    worth, spared = _sentences(
        [made("quick", 10.0, 5.0), made("exact", 40.0, 1.0), made("heavy", 200.0, 0.99)]
    )
    assert "`quick`, `exact`." in worth
    assert "heavy" not in worth
    assert spared.startswith("`heavy` takes 5.0 times as long as `exact`")
    assert "1.00, not 0.990" in spared


@pytest.mark.parametrize(
    ("seconds", "words"), [(30.0, "30 s"), (150.0, "2.5 min"), (9000.0, "2.5 h")]
)
def test_durations_in_words(seconds: float, words: str) -> None:
    assert _duration(seconds) == words
