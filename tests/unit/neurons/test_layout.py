import dataclasses

from rover_ncp.circuit.policy import parking_policy
from rover_ncp.circuit.policy_file import load_circuit, load_policy
from rover_ncp.neurons.layout import labels, layers

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
