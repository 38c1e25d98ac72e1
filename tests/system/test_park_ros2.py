"""The main job on ROS 2 robots: three processes, and a recording that replays to the bit."""

import json

import pytest

from deploy.replay import replay
from rover_ncp.cli import run


@pytest.mark.parametrize("model", ["turtlebot3-burger", "husky-a200"])
def test_a_ros2_robot_parks(model, tmp_path, capsys):
    out = tmp_path / "park"
    assert run(["park", "--model", model, "--out", str(out), "--json"]) == 0
    fields = json.loads(capsys.readouterr().out)
    assert fields["parked"]
    assert fields["policy"] == "course"
    assert replay(out / "run.mcap").difference is None
