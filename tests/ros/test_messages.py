"""Bytes, values and hashes of all message types against ROS's own packages."""

import dataclasses
import json
import subprocess

import numpy as np
import pytest
from ros.rig import FOLDER, PYTHON, ros_environment

from bridge.ros2.rmw import Topic
from rover_ncp.wire.cdr import decode, encode, type_hash
from rover_ncp.wire.key_table import KEYS, Kind
from rover_ncp.wire.messages import BOOL, HAZARDS, LASER_SCAN, POSE_STAMPED, TWIST

NO_WHEEL = {"tf2_msgs/msg/TFMessage", "foxglove_msgs/msg/ImageAnnotations", HAZARDS}
"""Types without a Python package on PyPI. A TFMessage is a list of TransformStamped."""
TYPES = {row.type for row in KEYS if row.kind is Kind.MESSAGE} | {BOOL, LASER_SCAN, POSE_STAMPED, TWIST}
TYPES |= {"geometry_msgs/msg/TransformStamped", "nav_msgs/msg/Path"}
EACH = 100


def ask_ros(*arguments, lines=()):
    """Return what ROS's serialiser says, as `messages.py` describes it."""
    done = subprocess.run(
        [PYTHON, FOLDER / "messages.py", *arguments],
        input="\n".join(lines),
        env=ros_environment(0),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def fields(message):
    """Return a message as `encode` takes it: dicts, lists of dicts, numpy arrays, numbers."""
    if dataclasses.is_dataclass(message):
        names = [field.name for field in dataclasses.fields(message)]  # constants are capitals
        return {name: fields(getattr(message, name)) for name in names if name.islower() and name[0] != "_"}
    return [fields(part) for part in message] if isinstance(message, list) else message


def plain(value):
    if isinstance(value, dict):
        return {name: plain(part) for name, part in value.items()}
    if isinstance(value, (list, np.ndarray)):
        return [plain(part) for part in value]
    return value.item() if isinstance(value, np.generic) else value


@pytest.fixture(scope="module")
def random_messages():
    return ask_ros("random", str(EACH), *sorted(TYPES - NO_WHEEL))


def test_random_messages_of_ros_have_equal_values_and_bytes_here(random_messages):
    assert len(random_messages) == EACH * len(TYPES - NO_WHEEL)
    for found in random_messages:
        message = decode(found["type"], bytes.fromhex(found["bytes"]))
        assert plain(fields(message)) == found["values"], found["type"]
    read_by_ros(
        [
            (
                found["type"],
                encode(found["type"], **fields(decode(found["type"], bytes.fromhex(found["bytes"])))),
            )
            for found in random_messages
        ]
    )


def read_by_ros(messages):
    """Assert that ROS reads the values that we read in these bytes, and writes as many itself."""
    answers = ask_ros("read", lines=[f"{ros_type} {data.hex()}" for ros_type, data in messages])
    for (ros_type, data), answer in zip(messages, answers, strict=True):
        # As text: NaN is equal to NaN.
        assert json.dumps(plain(fields(decode(ros_type, data)))) == json.dumps(answer["values"]), ros_type
        assert 0 <= answer["length"] - len(data) < 4, ros_type  # ROS may pad the end
    return answers


def test_hashes_and_keys_of_types_are_those_of_ros(random_messages):
    hashes = {found["type"]: found["hash"] for found in random_messages}
    assert set(hashes) == TYPES - NO_WHEEL
    for ros_type, known in hashes.items():
        assert type_hash(ros_type) == known
        package, _, name = ros_type.split("/")
        assert Topic("bot1/x", ros_type).key(5) == f"5/bot1/x/{package}::msg::dds_::{name}_/{known}"
