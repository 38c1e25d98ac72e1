"""The layout for Foxglove names topics, fields and neurons that recordings have."""

import json
import re

import pytest
from kit.paths import DATA, ROOT

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.files import shipped_names
from rover_ncp.recording.recording import read_recording
from rover_ncp.wire.cdr import decode

VIEWING = ROOT / "docs" / "viewing"
FOXGLOVE = json.loads((VIEWING / "rover-ncp.json").read_text())
LAYOUT = FOXGLOVE["configById"]
PATHS = [path["value"] for panel in LAYOUT.values() for path in panel.get("paths", ())]
"""Of the plots: TOPIC.FIELD.FIELD or TOPIC.FIELD[INDEX]."""
PARKING = {f"neurons/{name}" for name in load_policy("parking").circuit.neurons}
SHIPPED = {
    f"neurons/{name}" for each in shipped_names("policies") for name in load_policy(each).circuit.neurons
}


@pytest.fixture(scope="module")
def recorded():
    """A message of each topic of a real drive of the policy parking; of a neuron that it lacks, another's."""
    found = {message.topic: message for message in read_recording(DATA / "formats/0.1.0/drive.mcap").messages}
    assert {topic for topic in found if topic.startswith("neurons/")} == PARKING
    return found | dict.fromkeys(SHIPPED - PARKING, found["neurons/AVB"])


def test_every_topic_of_the_foxglove_layout_is_in_a_recording(recorded):
    named = {path.partition(".")[0] for path in PATHS}
    for panel in LAYOUT.values():
        named |= {*panel.get("topics", ()), *filter(None, [panel.get("topicPath")])}
    assert named <= recorded.keys()
    assert len(named) > len(SHIPPED)


@pytest.mark.parametrize("path", PATHS)
def test_every_plotted_field_is_in_its_message(path, recorded):
    topic, _, fields = path.partition(".")
    value = decode(recorded[topic].type, recorded[topic].data)
    for name, index in re.findall(r"(\w+)(?:\[(\d+)\])?", fields):
        value = getattr(value, name)
        value = value[int(index)] if index else value
    assert isinstance(float(value), float)
