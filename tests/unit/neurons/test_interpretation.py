import math

import numpy as np
import pytest
from kit.wirings import build_circuit

from rover_ncp.circuit.circuit import SynapseKind
from rover_ncp.neurons.interpretation import (
    Sign,
    slopes,
    time_constant_ranges,
)
from rover_ncp.neurons.trace import synapse_currents


def test_counts_signs_of_slopes_by_hand():
    #   da:  1   1   1  -1  -1   0   0  2
    #   db:  1  -1   0  -1   1   1   0  1
    a = [-70, -69, -68, -67, -68, -69, -69, -69, -67]
    b = [-50, -49, -50, -50, -51, -50, -49, -49, -48]
    found = slopes(a, b)
    assert (found.positive, found.negative, found.flat, found.vertical) == (4, 2, 1, 1)
    # Omega: +45, -45, 0, +45, -45, +90 (vertical, up), nothing, +26.57 degrees; bins are 18 degrees wide.
    assert found.bins == (0, 0, 2, 0, 0, 1, 1, 2, 0, 1)
    assert found.sign is Sign.POSITIVE  # 4 > 1.5 * 2
    vertical = slopes([-70.0] * 4, [-50, -40, -30, -40])
    assert (vertical.positive, vertical.negative, vertical.vertical) == (2, 1, 3)
    assert vertical.bins == (1, 0, 0, 0, 0, 0, 0, 0, 0, 2)


@pytest.mark.parametrize(
    ("positive", "negative", "sign"),
    [
        (3, 2, Sign.PHASE_SWITCHING),  # exactly half more is not more than half more
        (2, 4, Sign.ANTAGONISTIC),
        (0, 0, Sign.NONE),
    ],
)
def test_threshold_decides_the_sign(positive, negative, sign):
    steps = [1.0] * positive + [-1.0] * negative
    a = np.arange(len(steps) + 1.0) - 80
    b = np.concatenate([[-40.0], -40 + np.cumsum(steps)])
    assert slopes(a, b).sign is sign


def test_time_constants_by_hand():
    # C = 0.05 F, G = 1 S; at V = -40 mV a synapse is half open, far below it is shut.
    circuit = build_circuit("two", ["a", "b"], [(SynapseKind.EXCITATORY, 0, 1, 2.0)], sigma=0.5)
    found = time_constant_ranges(circuit, np.array([[-40.0, -70.0], [-90.0, -70.0]]), driven=["a"])
    assert [row.neuron for row in found] == ["b"]
    assert found[0].lowest_s == pytest.approx(0.05 / (1 + 2 * 0.5))
    assert found[0].highest_s == pytest.approx(0.05 / (1 + 2 / (1 + math.exp(25))))


def test_currents_and_pulls_by_hand():
    circuit = build_circuit(
        "three",
        ["a", "b", "c"],
        [
            (SynapseKind.EXCITATORY, 0, 2, 2.0),
            (SynapseKind.INHIBITORY, 1, 2, 1.0),
            (SynapseKind.GAP, 0, 1, 0.5),
        ],
    )
    found = synapse_currents(circuit, np.array([[-40.0, -40.0, -50.0]]))
    # Both chemical synapses are half open: 1 S towards 0 mV, 0.5 S towards -90 mV; leak 1 S towards -70 mV.
    assert found.current[0] == pytest.approx([1.0 * 50, 0.5 * -40, 0.5 * 0.0])
    target = (1 * -70 + 1.0 * 0 + 0.5 * -90) / 2.5
    without_excitation = (-70 - 45) / 1.5
    without_inhibition = -70 / 2
    assert found.pull[0, :2] == pytest.approx([target - without_excitation, target - without_inhibition])
    assert found.pull[0, 2] == pytest.approx(-60 + 70)
