"""What robots of ROS 2 do beside driving well: other settings, another clock, a second publisher."""

import pytest
from kit.bridge_bench import Driver, wait_for
from kit.paths import DATA
from ros.rig import MODEL, RosRun

BRIEF = str(DATA / "brief_course.yaml")
HUSKY = ["--odom", "platform/odom", "--imu", "sensors/imu_0/data", "--stop", "platform/emergency_stop"]
HUSKY += ["--battery", "platform/bms/state", "--volts", "25", "--accel", "1", "--alpha", "1"]


def test_a_husky_parks_in_a_namespace_by_best_effort_odometry_at_200_hz_and_a_clock_an_hour_ahead(tmp_path):
    robot = [*HUSKY, "--best-effort", "--rate", "200", "--clock", "3600"]
    with RosRun(tmp_path, model="husky-a200", namespace="a200_0001", robot=robot) as run:
        done = run.deploy("--model", "husky-a200", "--course", BRIEF).wait(60.0)
        assert (done.code, done.result["verdict"]) == (0, "parked"), done.last_line
        assert run.body.last["x"] == pytest.approx(0.3, abs=0.1)


def test_a_second_publisher_of_commands_stops_the_drive_and_the_driver_says_so(tmp_path):
    with RosRun(tmp_path) as run:
        deploy = run.deploy("--model", MODEL, "--course", BRIEF)
        wait_for(lambda: run.body.last["v"] > 0.05, 60.0)
        fields = '{"twist": {"linear": {"x": 0.1}}}'
        joystick = run.ros("joystick", "topic.py", "pub", "cmd_vel", "geometry_msgs/msg/TwistStamped", fields)
        done = deploy.wait(60.0)
        assert (done.code, done.result["stopped_by"]) == (4, "no-base")
        assert "publishes cmd_vel too" in done.result["reason"]
        assert "publishes cmd_vel too" in done.last_line
        joystick.stop()
        with Driver(run.robot) as driver:
            wait_for(lambda: driver.motors().granted, 20.0)
            driver.motors(enable=False)
