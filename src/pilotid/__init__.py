"""Identification of human-pilot models from tracking recordings.

Load a recording, choose a model and a method, and identify::

    import numpy as np
    import pilotid
    from pilotid.methods import method_named

    recording = pilotid.load_recording("run.csv")
    estimate = pilotid.identify(
        method_named("mle-white"), recording, pilotid.MODELS["single"], np.random.default_rng(1)
    )

Methods live in `pilotid.methods`, simulated data sets in `pilotid.datasets`.
"""

from pilotid.estimates.estimate import Estimate, Outcome
from pilotid.estimates.method import Method, identify
from pilotid.pilot.catalogue import MODELS, model_named
from pilotid.pilot.model import Channel, PilotModel
from pilotid.recordings.files import load_recording, save_recording
from pilotid.recordings.recording import Recording, joined
from pilotid.types import InputError

__version__ = "0.1.0"

__all__ = [
    "MODELS",
    "Channel",
    "Estimate",
    "InputError",
    "Method",
    "Outcome",
    "PilotModel",
    "Recording",
    "identify",
    "joined",
    "load_recording",
    "model_named",
    "save_recording",
]
