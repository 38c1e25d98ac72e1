"""Limits of the gate: the tighter of the file and the robot, in ranges with which the gate can compute."""

import pytest
from kit.virtual_bench import VirtualDriver, VirtualRig

from bridge.bases import gate_limits
from bridge.pioneer.setpoints import MotionLimits
from rover_ncp.core.errors import ConfigError, UsageError
from rover_ncp.robot.description import load_description


def limits_file(folder, text):
    (folder / "limits.yaml").write_text(text)
    return folder / "limits.yaml"


def test_the_gates_limits_are_those_of_the_robot(tmp_path):
    burger = load_description("turtlebot3-burger")
    limits = gate_limits(None, burger)
    assert (limits.v_max, limits.omega_max, limits.battery_min_v) == (0.22, 0.6, 10.5)
    for text, words in (
        ("v_max: 0.25", "v_max is 0.25, but turtlebot3-burger has 0.22 at most"),
        ("speed_mean_s: 1", "speed_mean_s is 1, but turtlebot3-burger has 0 at most"),
        ("battery_min_v: 10", "battery_min_v is 10, but turtlebot3-burger has 10.5 at least"),
    ):
        with pytest.raises(UsageError, match=words):
            gate_limits(limits_file(tmp_path, text), burger)


@pytest.mark.parametrize("model", [None, "p3at-sh"])
def test_brake_is_at_most_what_the_bridge_sets_in_a_pioneer(tmp_path, model):
    description, decel = model and load_description(model), MotionLimits().decel
    file = limits_file(tmp_path, f"brake: {decel}")
    assert gate_limits(None, description).brake < gate_limits(file, description).brake == decel
    limits_file(tmp_path, "brake: 0.32")
    with pytest.raises(UsageError, match=r"limits.yaml: brake is 0.32; expected at most 0.31"):
        gate_limits(file, description)


@pytest.mark.parametrize("checked", [True, False], ids=["--model FILE", "--model auto"])
def test_the_gate_keeps_the_limits_of_a_pioneers_description(checked, tmp_path):
    def connected(min_v, limits=None):
        file.write_text(f"{arm}\nbattery: {{nominal_v: 24.0, min_v: {min_v}}}\n")
        robot = load_description(file)
        rig = VirtualRig(robot, limits=gate_limits(limits, robot if checked else None))
        rig.sleep(3.0)
        return robot, VirtualDriver(rig)

    file, arm = tmp_path / "arm.yaml", "name: arm\nbased_on: p3at-sh\nmotion: {v_max: 0.2, omega_max: 0.4}"
    _, driver = connected(22.0, None if checked else limits_file(tmp_path, "battery_min_v: 11"))
    assert driver.motors().reason == "low-battery"  # the mock reports 12.7 V
    robot, driver = connected(11.5)
    driver.start().drive(1.0, 0.9, 0.9)
    assert driver.out == (0.2, 0.4)
    with pytest.raises(UsageError, match=r"v_max is 0.25, but arm has 0.2"):
        gate_limits(limits_file(tmp_path, "v_max: 0.25"), robot)


@pytest.mark.parametrize(
    "text",
    [
        "brake: 1e-310",
        "omega_max: 1e-320",
        "fence: {x_min: -1e300, x_max: 1e300, y_min: -1, y_max: 1}",
        "lease_s: 1e-9",
        "fence:",
        "sonar_stop_m: null",
        "battery_min_v: 1e9",
    ],
)
def test_limits_with_which_nothing_can_be_computed_are_refused(text, tmp_path):
    with pytest.raises(ConfigError):
        gate_limits(limits_file(tmp_path, text), None)
