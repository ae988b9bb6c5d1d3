"""Identification of human-pilot models from tracking recordings.

Load a recording, identify, and look::

    import pilotid

    recording = pilotid.load_recording("run.csv")
    estimate = pilotid.identify("mle", recording, "multi")
    estimate.summary()
    print(estimate["tdvis"].interval)
    pilotid.plot.describing_function(estimate)

Methods live in `pilotid.methods`, simulated data sets in `pilotid.datasets`; a study of
methods on scenarios is a `Study`.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pilotid.api import compare, design, identify, simulate, trust, which_model
    from pilotid.datasets.population import POPULATIONS, Population
    from pilotid.datasets.scenarios import SCENARIOS, Scenario
    from pilotid.estimates.estimate import Estimate, Outcome
    from pilotid.estimates.method import Method
    from pilotid.methods.arx import ARX
    from pilotid.methods.bayes import Bayes
    from pilotid.methods.fourier import Fourier
    from pilotid.methods.mle import MLE
    from pilotid.methods.mle_genetic import MLEGenetic
    from pilotid.methods.mle_reference import MLEReference
    from pilotid.methods.mle_white import MLEWhite
    from pilotid.methods.mle_windowed import MLEWindowed
    from pilotid.methods.mmle3 import MMLE3
    from pilotid.methods.rarx import RARX
    from pilotid.methods.sindy import SINDy
    from pilotid.methods.ukf import UKF
    from pilotid.pilot.catalogue import MODELS, model_named
    from pilotid.pilot.model import Channel, PilotModel
    from pilotid.recordings.files import load_recording, save_recording
    from pilotid.recordings.recording import Recording, joined
    from pilotid.show import plots as plot
    from pilotid.study.study import Study
    from pilotid.types import InputError

#: The one place of the version: pyproject.toml reads it here.
__version__ = "0.1.0"

__all__ = [
    "ARX",
    "MLE",
    "MMLE3",
    "MODELS",
    "POPULATIONS",
    "RARX",
    "SCENARIOS",
    "UKF",
    "Bayes",
    "Channel",
    "Estimate",
    "Fourier",
    "InputError",
    "MLEGenetic",
    "MLEReference",
    "MLEWhite",
    "MLEWindowed",
    "Method",
    "Outcome",
    "PilotModel",
    "Population",
    "Recording",
    "SINDy",
    "Scenario",
    "Study",
    "compare",
    "design",
    "identify",
    "joined",
    "load_recording",
    "model_named",
    "plot",
    "save_recording",
    "simulate",
    "trust",
    "which_model",
]

#: The modules that hold the names of `__all__`: `import pilotid` is instant, since a name is
#: fetched when it is first used.
_HOMES = {
    "api": ("compare", "design", "identify", "simulate", "trust", "which_model"),
    "datasets.population": ("POPULATIONS", "Population"),
    "datasets.scenarios": ("SCENARIOS", "Scenario"),
    "estimates.estimate": ("Estimate", "Outcome"),
    "estimates.method": ("Method",),
    "methods.arx": ("ARX",),
    "methods.bayes": ("Bayes",),
    "methods.fourier": ("Fourier",),
    "methods.mle": ("MLE",),
    "methods.mle_genetic": ("MLEGenetic",),
    "methods.mle_reference": ("MLEReference",),
    "methods.mle_white": ("MLEWhite",),
    "methods.mle_windowed": ("MLEWindowed",),
    "methods.mmle3": ("MMLE3",),
    "methods.rarx": ("RARX",),
    "methods.sindy": ("SINDy",),
    "methods.ukf": ("UKF",),
    "pilot.catalogue": ("MODELS", "model_named"),
    "pilot.model": ("Channel", "PilotModel"),
    "recordings.files": ("load_recording", "save_recording"),
    "recordings.recording": ("Recording", "joined"),
    "study.study": ("Study",),
    "types": ("InputError",),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}


if not TYPE_CHECKING:  # mypy would take any name for one that is here

    def __getattr__(name: str) -> object:
        """A public name, or a module of this package, when it is first asked for."""
        module = "pilotid.show.plots" if name == "plot" else f"pilotid.{name}"
        if name in _HOME:
            found = getattr(import_module(f"pilotid.{_HOME[name]}"), name)
        elif not name.startswith("_") and find_spec(module):
            found = import_module(module)
        else:
            raise AttributeError(f"module 'pilotid' has no attribute {name!r}")
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
