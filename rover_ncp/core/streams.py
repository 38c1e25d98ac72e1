"""Random streams: independent random numbers for each purpose and index of a root seed.

A stream's spawn key is its index, then the tag of its domain. Two streams of a seed therefore never share
bits. All random numbers that follow from a seed come from here, except those of the folder ``paper``.
"""

from enum import Enum, unique

import numpy as np


@unique
class Domain(Enum):
    """Purpose of a stream. Its value is the tag in the spawn key: results change with it."""

    TRIAL = None
    """No tag. An empty tuple would be no tuple in the Python 3.11.2 of Debian 12: its enum replaces it."""
    AGENT = (0,)
    SKID_ROBOT = (1,)
    CAMERA = (2, 0)
    BASE_SENSORS = (2, 1)
    IDENTIFICATION = (3,)
    COURSE = (5,)
    TRAINING = (7,)
    CMA_GENERATION = (8,)
    MOCK_FAULTS = (12,)
    EXPORT_VECTORS = (15,)
    STUDY = (17,)
    PICTURES = (18,)
    DOCKING = (19,)
    TRIAL_NOISE = (20,)
    TRIAL_LOSSES = (21,)
    TRIAL_AGES = (22,)
    LOCALISER = (23,)
    MASS_LEFT = (24,)
    PATCHES = (25,)


def stream_seed(seed: int, domain: Domain, index: int = 0) -> np.random.SeedSequence:
    """Return the seed of stream ``index`` of a domain; ``seed`` and ``index`` are below 2**64."""
    # A number in a spawn key may be one word or two, so that two-word indices would look like tags.
    high, low = divmod(index, 2**32)
    return np.random.SeedSequence(seed + (high << 64), spawn_key=(low, *(domain.value or ())))


def random_stream(seed: int, domain: Domain, index: int = 0) -> np.random.Generator:
    """Return the generator of stream ``index`` of a domain."""
    return np.random.Generator(np.random.PCG64(stream_seed(seed, domain, index)))


def integer_seed(seed: int, domain: Domain, index: int = 0) -> int:
    """Return 32 bits of stream ``index`` of a domain, as the seed of a generator that numpy does not make."""
    return int(stream_seed(seed, domain, index).generate_state(1)[0])
