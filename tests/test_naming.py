"""Things by name: settings as text, and objects taken from code."""

from __future__ import annotations

import subprocess
import sys
import types
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pilotid.datasets.signals import Remnant
from pilotid.likelihood.remnant_models import LowPass
from pilotid.methods import label_of, method_named
from pilotid.methods.arx import ARX
from pilotid.methods.bayes import Bayes
from pilotid.support.naming import (
    as_typed,
    code_digest,
    labelled,
    named,
    packed,
    split_list,
    to_jsonable,
    with_settings,
)
from pilotid.support.types import InputError


def load_object(text: str) -> Any:
    return named(text, {}, "thing", "NAME")


@dataclass(frozen=True)
class Inner:
    depth: int = 1
    wide: bool = False


@dataclass(frozen=True)
class Outer:
    number: float = 1.0
    count: int = 2
    word: str = "usual"
    on: bool = False
    maybe: float | None = 3.0
    either: int | str = 4
    kind: Literal["one-sided", "two-sided", 3] = "one-sided"
    pair: tuple[float, int] = (1.0, 2)
    many: tuple[str, ...] = ()
    inner: Inner = Inner()
    anything: Any = None
    made_up: tuple[float, ...] = field(default_factory=lambda: (1.0,))
    name: ClassVar[str] = "outer"


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("number=2", "number", 2.0),
        ("number=inf", "number", np.inf),
        ("count=7", "count", 7),
        ("word='7'", "word", "7"),
        ("on=TRUE", "on", True),
        ("maybe=none", "maybe", None),
        ("either=5", "either", 5),
        ("either='5'", "either", "5"),
        ("kind=3", "kind", 3),
        ("pair=(3, 4)", "pair", (3.0, 4)),
        ("many=[a, 'b c']", "many", ("a", "b c")),
        ("inner=Inner(wide=true)", "inner", Inner(wide=True)),
        ("anything=((1, 2.5), none, x)", "anything", ((1, 2.5), None, "x")),
    ],
)
def test_settings_are_read_as_their_types(text: str, name: str, value: object) -> None:
    thing = with_settings(Outer(), text, "outer")
    assert getattr(thing, name) == value
    assert type(getattr(thing, name)) is type(value)
    # What is shown of it can be typed again.
    label = labelled("outer", thing)
    assert named(label, {"outer": Outer()}, "thing", "NAME") == thing


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("size=2", "there is no setting 'size'; its settings are number, count, word"),
        ("count=2.0", "count=2: Input should be a valid integer"),
        ("inner=Inner(wde=true)", "there is no setting 'wde'"),
        ("number=abc", "number=abc: Input should be a valid number"),
        ("number=", "is not SETTING=VALUE"),
        ("on=1", "a valid boolean"),
        ("kind=both", "'one-sided', 'two-sided' or 3"),
        ("pair=(1, 2, 3)", "pair=(1, 2, 3): "),
        ("inner=Other(depth=1)", "Other(...) is not known there"),
        ("word=a b", "put words in quotes"),
        ("many=" + "(" * 2000 + ")" * 2000, "check brackets"),
    ],
)
def test_wrong_settings_are_a_sentence(text: str, words: str) -> None:
    with pytest.raises(InputError) as refusal:
        with_settings(Outer(), text, f"outer({text})")
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_class_is_made_and_what_it_refuses_is_a_sentence() -> None:
    assert with_settings(Inner, "depth=3", "Inner(depth=3)") == Inner(3)
    with pytest.raises(InputError, match="of order 0 to 3"):
        with_settings(Remnant, "order=9", "Remnant(order=9)")


WORDS = st.characters(exclude_characters=":")


@settings(deadline=None)
@given(
    st.builds(
        Outer,
        number=st.floats(allow_nan=False),
        count=st.integers(-(10**18), 10**18),
        word=st.text(WORDS),
        on=st.booleans(),
        maybe=st.none() | st.floats(allow_nan=False),
        either=st.integers() | st.text(WORDS),
        pair=st.tuples(st.floats(allow_nan=False), st.integers()),
        many=st.lists(st.text(WORDS)).map(tuple),
        inner=st.builds(Inner, depth=st.integers(), wide=st.booleans()),
    )
)
def test_every_label_can_be_typed(thing: Outer) -> None:
    label = labelled("outer", thing)
    assert named(label, {"outer": Outer()}, "thing", "NAME") == thing
    assert label.isprintable()


@settings(deadline=None)
@given(st.text())
def test_no_text_breaks_the_reader(text: str) -> None:
    for read in (
        split_list,
        method_named,
        lambda t: with_settings(Outer(), t, "outer"),
    ):
        try:
            read(text)
        except InputError:
            continue


# ----------------------------------------------------------------------------------- methods


@pytest.mark.parametrize(
    ("method", "label"),
    [
        (ARX(memory=None), "arx(memory=none)"),
        (ARX(memory=2.0), "arx(memory=2)"),
        (Bayes(likelihood="white", band=None), "bayes-white"),
        (Bayes(likelihood="white"), "bayes-white(band=50)"),
        (Bayes(noise=LowPass(2), most=10), "bayes(noise=LowPass(order=2), most=10)"),
    ],
)
def test_a_label_tells_the_settings_that_differ(method: object, label: str) -> None:
    assert label_of(method) == label  # type: ignore[arg-type]
    assert method_named(label) == method


# -------------------------------------------------------------------------------------- JSON


def test_settings_become_plain_objects_without_loss() -> None:
    import json

    held = to_jsonable(Outer(number=0.1 + 0.2, maybe=-np.inf, pair=(np.float64(1e-300), 2)))
    again = json.loads(json.dumps(held, allow_nan=False))
    assert again == held
    assert (again["class"], again["number"], again["maybe"]) == ("Outer", 0.1 + 0.2, "-inf")
    assert again["pair"] == [1e-300, 2]
    assert again["inner"] == {"class": "Inner", "depth": 1, "wide": False}
    assert to_jsonable({"a": np.arange(2)}) == {"a": [0, 1]}
    assert as_typed(again["inner"]) == "Inner(depth=1, wide=false)"


# -------------------------------------------------------------------------------------- code

MINE = """
from dataclasses import dataclass, field
from functools import lru_cache
import beside

@lru_cache
def doubled(number):
    return 2 * number

@dataclass(frozen=True)
class Mine:
    size: int = beside.SIZE
    more: tuple = field(default_factory=tuple)

    @property
    def twice(self):
        return doubled(self.size)

thing = Mine(9)

def later():
    import below.deep
"""


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    folder = tmp_path / "o'brien (1)"
    (folder / "below").mkdir(parents=True)
    (folder / "mine.py").write_text(MINE)
    (folder / "beside.py").write_text("SIZE = 3\n")
    (folder / "below" / "deep.py").write_text("")
    return folder / "mine.py"


@pytest.fixture(autouse=True)
def forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test imports from files of its own is gone after it."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    for name in ("beside", "below"):
        monkeypatch.delitem(sys.modules, name, raising=False)


def test_things_are_taken_from_files_and_modules(mine: Path) -> None:
    assert load_object(f"{mine}:Mine").size == 3
    assert load_object(f"{mine}:Mine(size=5)").size == 5
    assert load_object(f"{mine}:thing").size == 9
    assert load_object(f"{mine}:thing(size=1)").size == 1
    assert type(load_object(f"{mine}:Mine")) is type(load_object(f"{mine}:thing"))
    assert load_object("pilotid.methods.arx:ARX(memory=none)") == ARX(memory=None)


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("{}/none.py:Mine", "No such file"),
        ("{}:Mine", "Is a directory"),
        ("{}/mine.py:Yours", "holds no 'Yours'"),
        ("{}/syntax.py:X", "SyntaxError"),
        ("{}/leaves.py:X", "SystemExit: 4"),
        ("{}/bytes.py:X", "bytes.py: cannot be imported (SyntaxError"),
        ("no.such.module:X", "No module named 'no'"),
        ("pilotid.methods:ARX()x", "unknown thing 'pilotid.methods:ARX()x'"),
    ],
)
def test_code_that_cannot_be_used_is_a_sentence(mine: Path, place: str, words: str) -> None:
    folder = mine.parent
    (folder / "syntax.py").write_text("def")
    (folder / "leaves.py").write_text("import sys; sys.exit(4)")
    (folder / "bytes.py").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError) as refusal:
        load_object(place.format(folder))
    assert words in str(refusal.value)


def test_the_digest_covers_the_file_that_a_thing_is_from_and_what_it_imports(mine: Path) -> None:
    assert code_digest(ARX()) == code_digest(np.float64(1.0)) == ""
    digests = [code_digest(load_object(f"{mine}:Mine"))]
    (mine.parent / "other.py").write_text("SIZE = 3\n")
    assert code_digest((1, [load_object(f"{mine}:Mine")])) == digests[0]
    for file, text in ((mine.parent / "beside.py", "SIZE = 3\n"), (mine, MINE)):
        file.write_text(f"{text}# another\n")
        digests.append(code_digest(load_object(f"{mine}:Mine")))
    assert len({*digests}) == 3


def test_code_that_was_typed_in_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    space: dict[str, Any] = {"__name__": "__main__"}
    exec("class Mine:\n    def fit(self):\n        return 1\n", space)
    monkeypatch.setitem(sys.modules, "__main__", types.ModuleType("__main__"))
    with pytest.raises(InputError, match="write it to a file"):
        code_digest(space["Mine"]())


def test_code_of_a_file_goes_along_to_other_processes(mine: Path) -> None:
    sent = packed(load_object(f"{mine}:Mine(size=5)"))
    load = "from pilotid.support.naming import unpacked; import sys; "
    command = [sys.executable, "-c", f"{load}print(unpacked(sys.stdin.buffer.read()).twice)"]
    done = subprocess.run(command, input=sent, capture_output=True, check=True)
    assert int(done.stdout) == 10


def test_a_method_cannot_pass_for_another(tmp_path: Path) -> None:
    copy = tmp_path / "copy.py"
    copy.write_text("from pilotid.methods.arx import ARX\nclass Copy(ARX):\n    pass\n")
    with pytest.raises(InputError, match="has the name 'arx' of another one"):
        label_of(method_named(f"{copy}:Copy"))
    with pytest.raises(InputError, match="is no method"):
        method_named(f"{__name__}:SimpleNamespace")
    assert load_object(f"{__name__}:SimpleNamespace") == SimpleNamespace()
