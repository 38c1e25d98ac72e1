"""What real robots of ROS 2 do beside driving well: restarts, clocks, other publishers, other settings."""

import time

import pytest
from kit.bridge_bench import Driver, wait_for
from kit.paths import DATA
from ros.rig import MODEL, RosRun

BRIEF = str(DATA / "brief_course.yaml")
HUSKY = ["--odom", "platform/odom", "--imu", "sensors/imu_0/data", "--stop", "platform/emergency_stop"]
HUSKY += ["--battery", "platform/bms/state", "--volts", "25", "--accel", "1", "--alpha", "1"]
V = 0.15


def test_a_husky_parks_in_a_namespace_by_best_effort_odometry_at_200_hz_and_a_clock_an_hour_ahead(tmp_path):
    robot = [*HUSKY, "--best-effort", "--rate", "200", "--clock", "3600"]
    with RosRun(tmp_path, model="husky-a200", namespace="a200_0001", robot=robot) as run:
        done = run.deploy("--model", "husky-a200", "--course", BRIEF).wait(60.0)
        assert (done.code, done.result["verdict"]) == (0, "parked"), done.last_line
        assert run.body.last["x"] == pytest.approx(0.3, abs=0.1)


@pytest.mark.parametrize(("way", "start"), [("rclpy", (0.9, 0.2, 0.5)), ("pyzeros", (-0.4, 0.2, -0.3))])
def test_a_robot_that_restarts_in_the_drive_is_a_new_one(way, start, tmp_path):
    """By its place: two poses in a row that its speeds do not explain."""
    with RosRun(tmp_path, way=way) as run, Driver(run.robot) as driver:
        driver.start(v=V)
        driver.drive(0.5, v=V)
        run.body.kill()
        wait_for(lambda: driver.gate.ended == "no-base", 20.0)
        run.start_robot("--start", *start, name="again")
        wait_for(lambda: driver.motors().granted, 20.0)
        # The answer may overtake the odometry that made it possible.
        wait_for(lambda: max(map(abs, driver.odom.pose)) < 0.02, 5.0)
        driver.motors(enable=False)


def test_the_clock_of_a_robot_is_set_in_the_drive(tmp_path):
    with RosRun(tmp_path) as run, Driver(run.robot) as driver:
        driver.start(v=V)
        for step_s in (-0.6, 5.0, -0.9):
            run.body.tell(f"clock {step_s}")
            driver.drive(1.5, v=V)
            assert driver.odom.velocity.v == pytest.approx(V, abs=0.03)
            assert driver.gate.ended == "", step_s
            if step_s == -0.6:
                line = run.bridge.wait_for_line("the clock that stamps odom was set back by", 2.0)
                assert float(line.split()[0]) == pytest.approx(0.6, abs=0.15)  # a message's way is in it
        run.body.tell("clock -3")
        driver.drive(1.0, v=V)
        assert driver.gate.ended == "no-base"
        wait_for(lambda: driver.motors().granted, 20.0)
        driver.drive(0.5, v=0.1)
        driver.motors(enable=False)


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


def test_two_robots_that_publish_one_odometry_stop_the_rover(tmp_path):
    with RosRun(tmp_path) as run, Driver(run.robot) as driver:
        driver.start(v=V)
        run.start_robot("--start", "4", "0", "0", name="second")
        deadline = time.monotonic() + 10.0
        while driver.gate.ended != "no-base" and time.monotonic() < deadline:
            driver.drive(0.1, v=V)
        run.bridge.wait_for_line("the base is lost: two publishers on odom", 10.0)
