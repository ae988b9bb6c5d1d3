"""The public names, and the modules that hold them: `pilotid.__init__` reads this file."""

from pilotid.api import (
    check as check,
)
from pilotid.api import (
    compare as compare,
)
from pilotid.api import (
    design as design,
)
from pilotid.api import (
    identify as identify,
)
from pilotid.api import (
    simulate as simulate,
)
from pilotid.api import (
    trust as trust,
)
from pilotid.api import (
    which_model as which_model,
)
from pilotid.datasets.population import POPULATIONS as POPULATIONS
from pilotid.datasets.population import Population as Population
from pilotid.datasets.scenarios import SCENARIOS as SCENARIOS
from pilotid.datasets.scenarios import Scenario as Scenario
from pilotid.datasets.signals import Multisine as Multisine
from pilotid.datasets.signals import Remnant as Remnant
from pilotid.estimate.estimate import Estimate as Estimate
from pilotid.estimate.estimate import Outcome as Outcome
from pilotid.estimate.estimate import load_estimate as load_estimate
from pilotid.estimate.estimate import save as save
from pilotid.estimate.method import Method as Method
from pilotid.experiment.experiment import analyse as analyse
from pilotid.methods.arx import ARX as ARX
from pilotid.methods.bayes import Bayes as Bayes
from pilotid.methods.fourier import Fourier as Fourier
from pilotid.methods.mle import MLE as MLE
from pilotid.methods.mle_genetic import MLEGenetic as MLEGenetic
from pilotid.methods.mle_reference import MLEReference as MLEReference
from pilotid.methods.mle_white import MLEWhite as MLEWhite
from pilotid.methods.mmle3 import MMLE3 as MMLE3
from pilotid.methods.sindy import SINDy as SINDy
from pilotid.model.catalogue import MODELS as MODELS
from pilotid.model.catalogue import model_named as model_named
from pilotid.model.channel import Channel as Channel
from pilotid.model.element import ControlledElement as ControlledElement
from pilotid.model.element import element_named as element_named
from pilotid.model.factors import Canals as Canals
from pilotid.model.factors import Delay as Delay
from pilotid.model.factors import Differentiator as Differentiator
from pilotid.model.factors import Factor as Factor
from pilotid.model.factors import Gain as Gain
from pilotid.model.factors import Inverse as Inverse
from pilotid.model.factors import Lag as Lag
from pilotid.model.factors import Lead as Lead
from pilotid.model.factors import LookAhead as LookAhead
from pilotid.model.factors import Neuromuscular as Neuromuscular
from pilotid.model.factors import Parameter as Parameter
from pilotid.model.model import PilotModel as PilotModel
from pilotid.recording.files import (
    load_recording as load_recording,
)
from pilotid.recording.files import (
    save_recording as save_recording,
)
from pilotid.recording.recording import Recording as Recording
from pilotid.recording.recording import joined as joined
from pilotid.study.study import Study as Study
from pilotid.support.types import InputError as InputError

__version__: str
