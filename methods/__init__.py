"""The estimators, one a file.

A new method is one file here and one line in `METHODS`.  A method in another package
registers its class, callable without arguments, in the entry-point group
``pilotid.methods``; one in a file of your own is named as ``file.py:Class``.
"""

from __future__ import annotations

import warnings
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from pilotid.estimate.method import Method, method_fault
from pilotid.methods.arx import ARX
from pilotid.methods.bayes import Bayes
from pilotid.methods.fourier import Fourier
from pilotid.methods.mle import MLE
from pilotid.methods.mle_genetic import MLEGenetic
from pilotid.methods.mle_reference import MLEReference
from pilotid.methods.mle_white import MLEWhite
from pilotid.methods.mmle3 import MMLE3
from pilotid.methods.sindy import SINDy
from pilotid.naming.code import PluginWarning, is_place, reason, taken
from pilotid.naming.settings import from_catalogue, labelled
from pilotid.support.types import InputError

#: The methods of this package, in the order of tables and figures.
METHODS: tuple[Method, ...] = (
    MMLE3(),
    MLEWhite(),
    MLEGenetic(),
    MLE(),
    MLEReference(),
    Bayes(likelihood="white", band=None),
    Bayes(),
    Fourier(),
    ARX(),
    SINDy(),
)


@cache
def methods() -> dict[str, Method]:
    """All methods by name, those that other packages registered included.

    One that cannot be used costs a warning.
    """
    known = {method.name: method for method in METHODS}
    for entry in sorted(entry_points(group="pilotid.methods"), key=lambda e: e.name):
        try:
            method = _checked(entry.load()(), entry.value)
            if method.name in known:
                raise InputError(f"{entry.value}: there is a method '{method.name}' already")
            known[method.name] = method
        except (Exception, SystemExit) as error:  # packages of others may raise anything
            warnings.warn(_left_out(entry, error), PluginWarning, stacklevel=2)
    return known


def _left_out(entry: EntryPoint, error: BaseException) -> str:
    package = f" of package {entry.dist.name}" if entry.dist else ""
    why = str(error) if isinstance(error, InputError) else f"{entry.value}: {reason(error)}"
    return f"the method '{entry.name}'{package} is left out: {why}"


def method_named(text: str) -> Method:
    """The method that a text names, with its settings.

    Parameters
    ----------
    text
        ``arx``, ``arx(memory=none)``, ``package.module:Class`` or ``file.py:Class``, the
        last two with settings as well.

    Raises
    ------
    InputError
        If there is none; the message lists the names there are.
    """
    if is_place(text):
        return _checked(taken(text), text)
    return from_catalogue(text, methods(), "method", "CLASS")[1]


def label_of(method: Method) -> str:
    """A method's name, and the settings that are not its usual ones: ``arx(memory=none)``.

    Raises
    ------
    InputError
        If it is no method, or has the name of another one.
    """
    known = methods().get(_checked(method, type(method).__qualname__).name)
    if known is not None and type(known) is not type(method):
        raise InputError(
            f"the method {type(method).__qualname__} has the name '{method.name}' of another "
            "one; give it a name of its own"
        )
    return labelled(method.name, method, known)


def _checked(method: Method, given: str) -> Method:
    fault = method_fault(method)
    if fault:
        raise InputError(f"{given}: is no method: {fault}")
    return method
