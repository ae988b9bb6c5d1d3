"""Random generators by what they are for, so that results do not depend on order.

Every generator comes from one seed and a key: the same recording goes to every method
of a replication, and the numbers are the same for any number of workers.
"""

from __future__ import annotations

from zlib import crc32

import numpy as np

DEFAULT_SEED = 1


def recording_rng(seed: int, scenario: str, replication: int = 0) -> np.random.Generator:
    """The generator of a simulated recording's remnant.

    Parameters
    ----------
    seed, scenario, replication
        Seed of all random numbers, name of the scenario, and which of its recordings.
    """
    return _generator(seed, crc32(scenario.encode()), replication)


def fit_rng(
    seed: int, method: str, scenario: str = "", replication: int = 0
) -> np.random.Generator:
    """The generator of a fit; a recording from a file has no scenario and no replication.

    Parameters
    ----------
    seed, scenario, replication
        As for `recording_rng`.
    method
        Label of the method.
    """
    return _generator(seed, crc32(scenario.encode()), replication, crc32(method.encode()))


def start_rng(seed: int, scenario: str, replication: int = 0) -> np.random.Generator:
    """The generator of a replication's initial guesses, the same for every method.

    Parameters
    ----------
    seed, scenario, replication
        Seed of all random numbers, name of the scenario, and which of its recordings.
    """
    return _generator(seed, crc32(scenario.encode()), replication, crc32(b"start"))


def draw_rng(seed: int, scenario: str, replication: int = 0) -> np.random.Generator:
    """The generator of what a population draws for a replication, the same for every method.

    Parameters
    ----------
    seed, scenario, replication
        Seed of all random numbers, name of the scenario, and which of its recordings.
    """
    return _generator(seed, crc32(scenario.encode()), replication, crc32(b"draw"))


def _generator(seed: int, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
