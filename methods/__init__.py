"""The estimators, one a file.

A new method is one file here and one line in `METHODS`; one in a file or a package of your own is
named as ``file.py:Class`` or ``package.module:Class``.
"""

from __future__ import annotations

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
from pilotid.support.naming import labelled, named
from pilotid.support.types import InputError

#: The methods by name, in the order of tables and figures.
METHODS: dict[str, Method] = {
    method.name: method
    for method in (
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
}


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
    return _checked(named(text, METHODS, "method", "CLASS"), text)


def label_of(method: Method) -> str:
    """A method's name, and the settings that are not its usual ones: ``arx(memory=none)``.

    Raises
    ------
    InputError
        If it is no method, or has the name of another one.
    """
    known = METHODS.get(_checked(method, type(method).__qualname__).name)
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
