"""What a scenario's settings say."""

from __future__ import annotations

import math
import re

from pilotid.study.store import ScenarioEntry


def setting(entry: ScenarioEntry, name: str) -> float:
    """A number among all that defines a scenario, NaN if it is not there."""
    found = re.search(rf"\b{name}=(-?[\d.]+(?:e-?\d+)?)", entry.details)
    return float(found[1]) if found else math.nan
