"""The small form of a study's rows: the same rows, the same bytes, and sentences on damage."""

from __future__ import annotations

import lzma
from dataclasses import replace
from pathlib import Path

import pytest
from stores import content_of, finish

from pilotid.study.archive import DIGITS, KEPT
from pilotid.study.entries import Result
from pilotid.study.store import STORE, Store
from pilotid.types import InputError


def rounded(result: Result) -> Result:
    def to_digits(value: float | None) -> float | None:
        return None if value is None else float(f"{value:.{DIGITS}g}")

    numbers = [(key, *map(to_digits, values)) for key, *values in result.estimates]
    return replace(
        result,
        vaf=to_digits(result.vaf),
        seconds=to_digits(result.seconds),
        excess=to_digits(result.excess),
        estimates=tuple(numbers),  # type: ignore[arg-type]
    )


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """A folder with the small form beside the store that it was made of."""
    with finish(tmp_path, 4) as store:
        assert store.keep(tmp_path) == tmp_path / KEPT
    return tmp_path


def test_all_rows_come_back_with_six_digits(kept: Path) -> None:
    with Store(kept) as store:
        whole = content_of(store)
    (kept / STORE).unlink()
    with Store(kept) as store:
        found = content_of(store)
        assert store.path.name == KEPT
    assert replace(found, fits={}) == replace(whole, fits={})
    assert found.fits == {unit: rounded(result) for unit, result in whole.fits.items()}
    assert found.fits != whole.fits
    assert any(not result.usable for result in found.fits.values())


def test_kept_again_it_has_the_same_bytes(kept: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    again.mkdir()
    with Store(kept, small=True) as store:
        store.keep(again)
    assert (again / KEPT).read_bytes() == (kept / KEPT).read_bytes()
    assert (kept / KEPT).stat().st_size < (kept / STORE).stat().st_size / 10


def test_a_study_goes_on_from_kept_rows(kept: Path) -> None:
    with Store(kept, small=True) as store:
        held = content_of(store)
    (kept / STORE).unlink()
    for _ in range(2):  # made, and opened again
        with Store(kept, create=True) as store:
            assert content_of(store) == held
            assert store.path.name == STORE


def changed(content: bytes) -> bytes:
    return content[: len(content) // 2] + b"\0" + content[len(content) // 2 + 1 :]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is damaged, or holds no rows"),
        (b"no archive", "is damaged, or holds no rows"),
        (lzma.compress(b"{}"), "is damaged, or holds no rows"),
        (lzma.compress(b"[]\n{}"), "is damaged, or holds no rows"),
        (lzma.compress(b"not json\n{}"), "is damaged, or holds no rows"),
        (lzma.compress(b'{"format": 1}\n{}'), "written by another version of pilotid"),
    ],
)
def test_what_holds_no_rows_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / KEPT).write_bytes(content)
    with pytest.raises(InputError, match=words):
        Store(tmp_path)
    with pytest.raises(InputError, match=words):
        Store(tmp_path, create=True)
    with pytest.raises(InputError, match=words):  # nor does what that left pass for a study
        Store(tmp_path, create=True)


def test_damage_is_found_wherever_it_is(kept: Path) -> None:
    whole = (kept / KEPT).read_bytes()
    (kept / STORE).unlink()
    for content in (changed(whole), whole[:-1], whole[: len(whole) // 2]):
        (kept / KEPT).write_bytes(content)
        with pytest.raises(InputError, match="is damaged, or holds no rows"):
            Store(kept)
