"""The estimators, one a file.

A new method is one file here and one line in `METHODS`.  A method in another package
registers its class, callable without arguments, in the entry-point group
``pilotid.methods``.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points

from pilotid.estimates.method import Method
from pilotid.methods.arx import ARX
from pilotid.methods.bayes import Bayes
from pilotid.methods.fourier import Fourier
from pilotid.methods.mle import MLE
from pilotid.methods.mle_white import MLEWhite
from pilotid.methods.mmle3 import MMLE3
from pilotid.methods.sindy import SINDy
from pilotid.types import InputError

#: The methods of this package, in the order of tables and figures.
METHODS: tuple[Method, ...] = (
    MMLE3(),
    MLEWhite(),
    MLE(),
    Bayes(likelihood="white", band=None),
    Bayes(),
    Fourier(),
    ARX(),
    SINDy(),
)


@cache
def methods() -> dict[str, Method]:
    """All methods by name, those that other packages registered included."""
    known = {method.name: method for method in METHODS}
    for entry in sorted(entry_points(group="pilotid.methods"), key=lambda e: e.name):
        method: Method = entry.load()()
        if method.name in known:
            raise InputError(
                f"the method '{method.name}' that {entry.value} registers exists already; "
                "give it another name"
            )
        known[method.name] = method
    return known


def method_named(name: str) -> Method:
    """The method of that name; `InputError` lists the names there are."""
    known = methods()
    if name not in known:
        raise InputError(f"unknown method '{name}': choose from {', '.join(known)}")
    return known[name]
