"""The main job on ROS 2 robots: three processes, and a recording that replays to the bit."""

import json

import pytest
from kit.paths import DATA

from deploy.replay import replay
from rover_ncp.cli import run
from rover_ncp.robot.description import load_description

FIFTH = pytest.param(str(DATA / "fifth_robot.yaml"), id="fifth")


@pytest.mark.parametrize("model", ["turtlebot3-burger", "husky-a200", FIFTH])
def test_a_ros2_robot_parks(model, tmp_path, capsys):
    """The fifth robot is one file and no code."""
    out = tmp_path / "park"
    assert run(["park", "--model", model, "--out", str(out), "--json"]) == 0
    said = capsys.readouterr()
    fields = json.loads(said.out)
    assert fields["parked"]
    assert ("times as long" in said.err) == (load_description(model).motion.v_max < 0.24)
    assert fields["policy"] == "course"
    assert replay(out / "run.mcap").difference is None
