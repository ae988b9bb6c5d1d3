"""What was found out about a recording is kept as long as the recording is there."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

from pilotid.recordings.recording import Recording

P = ParamSpec("P")
T = TypeVar("T")


def remembered(
    function: Callable[Concatenate[Recording, P], T],
) -> Callable[Concatenate[Recording, P], T]:
    """Work a function of a recording out once for each recording, which never changes.

    Parameters
    ----------
    function
        Its further arguments must be hashable; what it returns must be small, and nobody may
        change it.
    """
    known: WeakKeyDictionary[Recording, dict[tuple[Any, ...], T]] = WeakKeyDictionary()

    @wraps(function)
    def recalled(recording: Recording, /, *arguments: P.args, **named: P.kwargs) -> T:
        own = known.setdefault(recording, {})
        key = (arguments, tuple(named.items()))
        if key not in own:
            own[key] = function(recording, *arguments, **named)
        return own[key]

    return recalled
