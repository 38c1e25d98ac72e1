"""The main job on ROS 2 robots: three processes, and a recording that replays to the bit."""

import json
from pathlib import Path

import pytest

from deploy.replay import replay
from rover_ncp.cli import run
from rover_ncp.robot.description import load_description

FIFTH = """
name: fifth
based_on: turtlebot4
footprint: {radius_m: 0.25}
motion: {v_max: 0.15, omega_max: 0.9, accel: 0.5, decel: 0.5}
topics: {odom: wheels/odom, cmd_vel: base/cmd_vel, cmd_vel_type: TwistStamped, base_frame: base_footprint}
"""


@pytest.mark.parametrize("model", ["turtlebot3-burger", "husky-a200", "fifth.yaml"])
def test_a_ros2_robot_parks(model, tmp_path, capsys):
    """The fifth robot is one file and no code."""
    if model == "fifth.yaml":
        model = str(tmp_path / model)
        Path(model).write_text(FIFTH)
    out = tmp_path / "park"
    assert run(["park", "--model", model, "--out", str(out), "--json"]) == 0
    said = capsys.readouterr()
    fields = json.loads(said.out)
    assert fields["parked"]
    assert ("times as long" in said.err) == (load_description(model).motion.v_max < 0.24)
    assert fields["policy"] == "course"
    assert replay(out / "run.mcap").difference is None
