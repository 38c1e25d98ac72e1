"""Networks in lanes against their textbook equations, and on courses."""

import numpy as np
import pytest

from paper.networks import (
    NetKind,
    allocate_networks,
    net_for,
    start_network,
    tick_networks,
)
from rover_ncp.circuit.policy import course_policy, parking_policy
from rover_ncp.circuit.policy_file import load_circuit

PARKING = parking_policy(load_circuit("parking"))
FOLLOWING = course_policy(load_circuit("tap_withdrawal"))


def textbook(net, vector, observations):
    """Return the commands (T, outputs) of one network for observations (T, inputs)."""
    cells, columns = net.cells, net.columns
    first, last = (vector[block.slice] for block in net.layout().blocks)
    hidden_rows = first.reshape(net.gates, cells, columns)
    output_rows = last.reshape(len(net.high), cells + 1)
    hidden = memory = np.zeros(cells)
    commands = []
    for row in observations:
        x = np.clip((row - net.center) / np.array(net.scale), -np.array(net.most), net.most)
        if net.kind is NetKind.MLP:
            hidden = np.tanh(hidden_rows[0] @ [*x, 1.0])
        else:
            i, f, g, o = hidden_rows @ [*x, *hidden, 1.0]
            sigmoid = [1.0 / (1.0 + np.exp(-gate)) for gate in (i, f, o)]
            memory = sigmoid[1] * memory + sigmoid[0] * np.tanh(g)
            hidden = sigmoid[2] * np.tanh(memory)
        z = np.clip(output_rows @ [*hidden, 1.0], -1.0, 1.0)
        commands.append(np.where(z > 0, np.array(net.high) * z, -np.array(net.low) * z))
    return np.array(commands)


@pytest.mark.parametrize("kind", [NetKind.MLP, NetKind.LSTM])
@pytest.mark.parametrize("policy", [PARKING, FOLLOWING], ids=["pose", "layers"])
def test_every_lane_is_the_textbook_network(kind, policy):
    net, rng, count = net_for(policy, kind), np.random.default_rng(1), 5
    lanes, layout = allocate_networks(net, count), net.layout()
    vectors = rng.uniform(layout.lower, layout.upper, (count, layout.size)) / 3.0
    for lane in range(count):
        start_network(lanes, lane, vectors[lane])
    observations = rng.uniform(-1.5, 1.5, (6, len(policy.sensing.inputs), count))
    got = []
    for seen in observations:
        commands = np.empty((2, count))
        tick_networks(lanes, seen, commands)
        got.append(commands)
    for lane in range(count):
        expected = textbook(net, vectors[lane], observations[:, :, lane])
        np.testing.assert_allclose(np.array(got)[:, :, lane], expected, rtol=1e-12, atol=1e-14)


def test_sizes_ranges_and_limits_are_those_of_the_circuit():
    mlp, lstm = (net_for(PARKING, kind) for kind in NetKind)
    assert mlp.layout().size == 11 * (4 + 1) + 2 * (11 + 1)
    assert lstm.layout().size == 4 * 11 * (4 + 11 + 1) + 2 * (11 + 1)
    assert (mlp.low, mlp.high) == ((0.0, -0.18), (0.16, 0.18))
    assert mlp.most == (1.0,) * 4
    assert net_for(FOLLOWING, NetKind.MLP).scale == (0.2, 0.2, 0.4, 0.16, 0.18)
