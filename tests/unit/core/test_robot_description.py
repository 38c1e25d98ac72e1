"""Robot descriptions: the shipped ones are complete, a fifth robot takes one file, bad ones are refused."""

from pathlib import Path

import pytest

from bridge.bases import choose_base, gate_limits
from rover_ncp.core.errors import ConfigError, UsageError
from rover_ncp.robot.description import load_description
from sim.world.described import described_rover


def test_a_new_robot_takes_one_file(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(
        "name: mine\nbased_on: turtlebot3-burger\nfootprint: {radius_m: 0.15}\nmotion: {v_max: 0.18}\n"
        "topics: {cmd_vel: base/cmd_vel, cmd_vel_type: Twist}\n"
    )
    mine = load_description(file)
    assert (mine.length_m, mine.width_m, mine.motion.v_max, mine.motion.omega_max) == (0.3, 0.3, 0.18, 2.84)
    assert (mine.topics.cmd_vel, mine.topics.base_frame) == ("base/cmd_vel", "base_footprint")
    assert gate_limits(None, mine).v_max == 0.18
    assert described_rover(mine).width == 0.3
    assert choose_base("ros2/tcp/robot", str(file)).description == mine


def test_a_description_is_based_on_a_file_beside_it_whatever_the_working_folder(tmp_path, monkeypatch):
    robots = tmp_path / "robots"
    (robots / "shared").mkdir(parents=True)
    (robots / "mine.yaml").write_text("name: mine\nbased_on: shared/base.yaml\n")
    (robots / "shared/base.yaml").write_text("name: base\nbased_on: ../root.yaml\n")
    (robots / "root.yaml").write_text("name: root\nbased_on: p3at\nmass_kg: 7\n")
    (tmp_path / "root.yaml").write_text("name: wrong\nbased_on: p3at\nmass_kg: 8\n")
    for folder in (tmp_path, robots):
        monkeypatch.chdir(folder)
        assert load_description(robots / "mine.yaml").mass_kg == 7.0
    (robots / "root.yaml").unlink()
    with pytest.raises(ConfigError, match=r"shared/base\.yaml: \$\.based_on: .*root\.yaml: no such file"):
        load_description(robots / "mine.yaml")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "the file is empty|mapping"),
        ("name: x\nbased_on: p3at\nmotion: {v_max: -1}\n", r"\$.motion.v_max"),
        ("name: x\nbased_on: p3at\nwheels: {axles_m: 0}\n", "a skid drive needs wheels.axles_m"),
        ("name: x\nbased_on: p3at\ntopics: {odom: /odom}\n", r"\$.topics.odom"),
        ("name: x\nbased_on: turtlebot4\nscan: {range_m: [3.0, 0.1]}\n", "the smaller range first"),
        ("name: x\nbased_on: turtlebot4\nmotion: {wheel_min: 0.4}\n", "wheel_min is 0.4, expected less"),
        ("name: x\nbased_on: p3at\nspeed: 1\n", r"\$.speed: unknown key"),
        ("name: x\n", r"\$.footprint"),
        ("name: loop\nbased_on: bad.yaml\n", r"\$\.based_on: at most 4 steps .*: is a file based on itself"),
    ],
)
def test_bad_files_are_refused(tmp_path, monkeypatch, text, expected):
    monkeypatch.chdir(tmp_path)
    Path("bad.yaml").write_text(text)
    with pytest.raises(ConfigError, match=expected):
        load_description("bad.yaml")


@pytest.mark.parametrize(
    ("base", "model", "expected"),
    [
        ("ros2/tcp/robot", "auto", "--model auto: .*turtlebot4"),
        ("ros2/tcp/robot", "p3at-sh", "no topics"),
        ("tcp/robot", "turtlebot4", "has no arcos"),
    ],
)
def test_a_model_that_does_not_fit_its_address_is_refused(base, model, expected):
    with pytest.raises(UsageError, match=expected):
        choose_base(base, model)
