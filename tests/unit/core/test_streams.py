"""Random streams: no two of a seed share bits, and everything draws from one of them."""

import numpy as np
import pytest

from rover_ncp.core.streams import Domain, stream_seed

INDICES = (*range(20), 2**32 - 1, 2**32, 2**33 + 5, 2**40)


@pytest.mark.parametrize("seed", [0, 1, 2**63 - 1])
def test_no_two_streams_of_a_seed_share_bits(seed):
    words = [np.random.SeedSequence(seed).generate_state(8)]
    words += [stream_seed(seed, domain, index).generate_state(8) for domain in Domain for index in INDICES]
    assert len({tuple(row.tolist()) for row in words}) == 1 + len(Domain) * len(INDICES)
    assert len(np.unique(np.concatenate(words))) > 8 * len(words) - 5  # by chance, 32 bits may be equal
