"""The layout for Foxglove names topics and neurons that recordings have."""

import json

from kit.paths import DATA, ROOT

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.files import shipped_names
from rover_ncp.recording.recording import read_recording

VIEWING = ROOT / "docs" / "viewing"
FOXGLOVE = json.loads((VIEWING / "rover-ncp.json").read_text())
LAYOUT = FOXGLOVE["configById"]
PATHS = [path["value"] for panel in LAYOUT.values() for path in panel.get("paths", ())]
"""Of the plots: TOPIC.FIELD.FIELD or TOPIC.FIELD[INDEX]."""
PARKING = {f"neurons/{name}" for name in load_policy("parking").circuit.neurons}
SHIPPED = {
    f"neurons/{name}" for each in shipped_names("policies") for name in load_policy(each).circuit.neurons
}


def test_every_topic_of_the_foxglove_layout_is_in_a_recording():
    recorded = {message.topic for message in read_recording(DATA / "formats/0.1.0/drive.mcap").messages}
    assert {topic for topic in recorded if topic.startswith("neurons/")} == PARKING
    named = {path.partition(".")[0] for path in PATHS}
    for panel in LAYOUT.values():
        named |= {*panel.get("topics", ()), *filter(None, [panel.get("topicPath")])}
    assert named <= recorded | SHIPPED
    assert len(named) > len(SHIPPED)
