import dataclasses

import numpy as np
import pytest

from paper.tasks import build_circuit
from rover_ncp.circuit.circuit import SynapseKind
from rover_ncp.circuit.policy import parking_policy
from rover_ncp.circuit.policy_file import load_circuit, load_policy
from rover_ncp.core.files import shipped_names
from rover_ncp.neurons.layout import HEIGHT, RADIUS, WIDTH, labels, lay_out, layers, name_lines

PARKING = parking_policy(load_circuit("parking"))
PARKING_NEURONS = PARKING.circuit.neurons


def test_layers_of_the_parking_circuit():
    found = dict(zip(PARKING_NEURONS, layers(PARKING), strict=True))
    assert [[name for name in found if found[name] == layer] for layer in dict.fromkeys(found.values())] == [
        ["PVD", "PLM", "AVM", "ALM"],
        ["AVA", "AVB"],
        ["AVD", "PVC", "DVA"],
        ["LFT", "RGT", "FWD"],
    ]
    assert list(dict.fromkeys(found.values())) == ["sensory", "command", "inter", "motor"]


def points_of(curve):
    t = np.linspace(0, 1, 50)[:, None]
    a, c, b = np.reshape(curve, (3, 2))
    return (1 - t) ** 2 * a + 2 * t * (1 - t) * c + t**2 * b


def random_policy(seed):
    """A wiring that no table knows, with 28 synapses; its sensory and motor neurons have the usual names."""
    rng = np.random.default_rng(seed)
    pairs = [(i, j) for i in range(13) for j in (2, 3, 4, 5, 8, 9, 10, 11, 12) if i != j]
    chosen = rng.choice(len(pairs), 28, replace=False)
    rows = [(SynapseKind(rng.integers(3)), *pairs[k], 1.0) for k in chosen]
    return parking_policy(build_circuit("random", [*PARKING_NEURONS, "other"], rows))


@pytest.mark.parametrize(
    ("policy", "most"),
    [
        *((load_policy(name), 0) for name in shipped_names("policies")),
        *((random_policy(k), 3) for k in range(4)),
    ],
)
def test_synapses_avoid_foreign_neurons_and_each_other(policy, most):
    layout, wiring = lay_out(policy), policy.circuit
    places = np.array(layout.places)
    assert (places >= RADIUS).all()
    assert (places <= [WIDTH - RADIUS, HEIGHT - RADIUS]).all()
    curves = [points_of(curve) for curve in layout.curves]
    through = covered = 0
    for number, (curve, *ends) in enumerate(zip(curves, wiring.source, wiring.destination, strict=True)):
        foreign = np.delete(places, ends, axis=0)
        through += np.hypot(*(curve[:, None] - foreign).T).min() < RADIUS
        for other in curves[:number]:
            apart = np.hypot(*(curve[10:-10, None] - other).T).min(axis=0)
            covered += np.mean(apart < 4.0) > 0.5
    assert through <= most
    assert covered <= most


def test_left_motor_neuron_is_drawn_left():
    places = dict(zip(PARKING_NEURONS, lay_out(PARKING).places, strict=True))
    assert places["LFT"][0] < places["RGT"][0]


def test_synapse_of_a_neuron_on_itself_is_drawn():
    looped = build_circuit("loop", PARKING_NEURONS, [(SynapseKind.EXCITATORY, 2, 2, 1.0)])
    x0, y0, _, _, x1, y1 = lay_out(parking_policy(looped)).curves[0]
    assert np.hypot(x0 - x1, y0 - y1) > 5


def test_sensory_neuron_onto_a_motor_neuron_stays_sensory():
    direct = build_circuit("direct", PARKING_NEURONS, [(SynapseKind.EXCITATORY, 0, 9, 1.0)])
    assert layers(parking_policy(direct))[0] == "sensory"


def test_labels_name_the_largest_parts_of_a_mixture():
    policy = load_policy("course")
    found = labels(policy)
    assert (found["FWD"], found["REV"]) == ("right", "forward, left")
    assert (found["PLM"], found["AVM"]) == ("speed − heading > 0", "speed − heading < 0")
    # Of the row below, the second is less than a quarter of the first.
    alone = policy.input_layer * [[0.0, 0.0, 0.0, 1.0, 0.3], [1.0, 1.0, 1.0, 1.0, 1.0]]
    assert labels(dataclasses.replace(policy, input_layer=alone))["PLM"] == "speed > 0"
    assert labels(dataclasses.replace(policy, input_layer=-alone))["PLM"] == "− speed > 0"
    assert labels(load_policy("parking"))["PVD"] == "x"


def test_motor_neurons_are_labelled_by_what_they_do():
    found = labels(load_policy("parking"))
    assert [found[neuron] for neuron in ("FWD", "LFT", "RGT")] == ["forward", "left", "right"]
    assert labels(load_policy("reverse"))["REV"] == "backward"


@pytest.mark.parametrize(
    ("name", "lines"),
    [
        ("AVB", ["AVB"]),
        ("TURN_L", ["TURN_L"]),
        ("LEFT_OF_ME", ["LEFT_", "OF_ME"]),
        ("POINTS_LEFT", ["POINTS", "_LEFT"]),
        ("TEMPERATURE", ["TEMPER", "ATURE"]),
        ("A_NAME_OF_MANY_LETTERS", ["A_NAME", "_OF_…"]),
    ],
)
def test_long_names_are_broken_into_lines_that_fit(name, lines):
    assert name_lines(name) == lines
