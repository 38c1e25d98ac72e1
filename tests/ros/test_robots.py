"""What real robots of ROS 2 do beside driving well: restarts, clocks, other publishers, other settings."""

import time

import pytest
from kit.bridge_bench import Driver, wait_for
from kit.paths import DATA
from ros.rig import MODEL, RosRun

from sim.park.live import Process

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


@pytest.mark.parametrize(
    ("namespace", "robot", "problem"),
    [
        (
            "a",
            [],
            "no nav_msgs/msg/Odometry arrives on odom; published there: a/battery_state, a/imu, a/odom",
        ),
        ("", ["--rate", "1"], "odometry on odom arrives 1."),
        (
            "",
            ["--twist"],
            "the robot takes geometry_msgs/msg/Twist on cmd_vel: set topics.cmd_vel_type",
        ),
        (
            "",
            ["--odom-type", "geometry_msgs/msg/PoseStamped"],
            "odom: it has the type geometry_msgs/msg/PoseStamped",
        ),
        ("", ["--frames", "map", "base"], "odometry is of map → base, expected odom → base_link"),
    ],
    ids=["namespace", "1 Hz", "type of cmd_vel", "type of odom", "frames"],
)
def test_a_bridge_that_cannot_serve_a_robot_names_the_topic_and_what_is_there(
    namespace, robot, problem, tmp_path
):
    run = RosRun(tmp_path, robot=["--namespace", namespace, *robot])
    try:
        run.start_robot_side()
        options = ["--base", f"ros2/tcp/{run.base}", "--model", "turtlebot4", "--listen", "tcp/127.0.0.1:0"]
        with Process("bridge", options, tmp_path) as bridge:
            done = bridge.wait(30.0)
    finally:
        run.close()
    assert done.code == 3
    assert problem in done.result["error"]


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


@pytest.mark.parametrize(
    ("hazards", "code", "name", "words"),
    [
        ("null", 0, "watchdog", "not known whether the base halts"),
        ("hazard_detection", 1, "inputs", "no message on hazard_detection"),  # it does not send them
    ],
)
def test_check_of_a_robot_fails_if_its_hazards_are_silent(hazards, code, name, words, tmp_path):
    model = tmp_path / "mine.yaml"
    model.write_text(f"name: mine\nbased_on: {MODEL}\ntopics: {{hazards: {hazards}}}\n")
    with RosRun(tmp_path, model=str(model), robot=["--rate", "40"]) as run:
        about = ["--robot", run.robot, "--on-blocks", "--model", str(model)]
        with Process("check", about, tmp_path) as check:
            done = check.wait(60.0)
        findings = {finding["name"]: finding for finding in done.result["findings"]}
        assert done.code == code, findings
        assert words in findings[name]["detail"]
