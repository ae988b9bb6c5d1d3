"""Identification of human-pilot models from tracking recordings.

Load a recording, identify, and look::

    import pilotid

    recording = pilotid.load_recording("run.csv")
    estimate = pilotid.identify(recording, "multi", "mle")
    print(estimate.summary())
    print(estimate["tdvis"].interval)
    pilotid.plot.describing_function(estimate)

Methods live in `pilotid.methods`, simulated data sets in `pilotid.datasets`; a study of
methods on scenarios is a `Study`.
"""

import ast
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

#: The one place of the version: pyproject.toml reads it here.
__version__ = "1.0.0rc2"

#: The modules that hold the public names, by the stub beside this file: `import pilotid` is
#: instant, since a name is fetched when it is first used.
_HOME = {
    alias.asname or alias.name: node.module or ""
    for node in ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8")).body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> object:
    """A public name, or a module of this package, when it is first asked for."""
    module = "pilotid.plots.plots" if name == "plot" else f"pilotid.{name}"
    if name in _HOME and name != "plot":
        thing = getattr(import_module(_HOME[name]), name)
    elif not name.startswith("_") and find_spec(module):
        thing = import_module(module)
    else:
        raise AttributeError(f"module 'pilotid' has no attribute {name!r}")
    globals()[name] = thing
    return thing


def __dir__() -> list[str]:
    return [*__all__, "datasets", "methods", "plot", "__version__"]
