"""The safety matrix with a ROS 2 robot behind the bridge: the rows whose fault such a robot can have.

Where the bridge lives, the bounds are those of the Pioneer. Where it is dead, hung or cut off from the robot,
the robot's own timeout stops it. Braking is that of its description.
"""

import json
import os
import time
from pathlib import Path
from signal import SIGINT, SIGKILL

import pytest
from faults.hang import CLOCK_STEPS_S
from faults.measure import MAX_LATE_S, measure
from faults.rig import Rig
from faults.row import DELAY_S, LOW_BATTERY_S, STOP_S
from faults.table import MATRIX, ROS2_ROWS, ROWS
from kit.paths import DATA, ROOT

from rover_ncp.robot.description import load_description
from sim.live.live_run import RMW_ZENOH, ROS2DDS
from sim.live.processes import Process, wait_for
from sim.live.truth import SAMPLE_S
from sim.pioneer.ros2_robot import BATTERY_S

pytestmark = pytest.mark.timed

MODEL = "husky-a200"
HUSKY = load_description(MODEL)
COURSE = DATA / "prompt_course.yaml"
PAGE = ROOT / "docs" / "safety.md"
ROWS_FILE = os.environ.get("ROVER_NCP_SAFETY_ROWS")

WITHOUT = {
    "bumper": "this robot has none",
    "stall": "this robot reports none",
    "bumper-again": "this robot has none",
    "line-reset": "Zenoh connects again within 0.2 s, and the drive goes on",
    **{
        f"bridge-clock-{step_s:g}": "it drops commands with old stamps: both clocks must agree"
        for step_s in CLOCK_STEPS_S.values()
    },
}
# Rows without an act are measured with a Pioneer, or below.
KEYS = [row.key for row in (*MATRIX, *ROS2_ROWS) if row.act and not row.outlet and row.key not in WITHOUT]
CHECK_S = {"check-interrupted": STOP_S, "check-killed": 1.0}
"""A check that is killed no longer renews its lease, which lasts 1 s."""
SHORT = {"bridge-killed"}


def allowed_s(row, v, omega):
    """Return the time within which the robot must stand."""
    motion, delays = HUSKY.motion, HUSKY.delays
    braking = max(delays.v_s, delays.omega_s) + max(abs(v) / motion.decel, abs(omega) / motion.alpha_decel)
    bound = HUSKY.topics.cmd_vel_timeout_s if row.layer in {"line", "bridge"} else STOP_S
    # The bridge gets the voltage with the robot's next report of its battery.
    return bound + (LOW_BATTERY_S + BATTERY_S if row.key == "low-battery" else 0.0) + braking


def record(key, form, seconds, allowed_s):
    """Save a measured row for the page, and return it."""
    found = {"row": key, "form": form, "seconds": round(seconds, 2), "allowed_s": round(allowed_s, 2)}
    if ROWS_FILE:
        with Path(ROWS_FILE).open("a") as file:
            file.write(json.dumps(found) + "\n")
    return found


@pytest.fixture(
    scope="module",
    params=[pytest.param(form, marks=pytest.mark.xdist_group(form)) for form in (ROS2DDS, RMW_ZENOH)],
    ids=["ros2dds", "rmw-zenoh"],
)
def rig(request, tmp_path_factory):
    form = request.param
    mock = ["--ros2", "--model", MODEL, "--ros", "rmw-zenoh" if form == RMW_ZENOH else "ros2dds"]
    with Rig(
        tmp_path_factory.mktemp("rig"),
        COURSE,
        mock=mock,
        bridge=["--model", MODEL, "--no-base-watchdog"],
        base_form=form,
    ) as rig:
        rig.form = "rmw_zenoh" if form == RMW_ZENOH else "ros2dds"
        yield rig


@pytest.mark.parametrize(
    "key", [pytest.param(key, marks=[pytest.mark.short] if key in SHORT else []) for key in KEYS]
)
def test_the_robot_stands_in_time_and_stays(rig, key):
    row = ROWS[key]
    measured = measure(rig, row, row.drivers[0])
    allowed = allowed_s(row, measured.v, measured.omega)
    found = record(key, rig.form, measured.seconds, allowed)
    assert measured.late_s <= MAX_LATE_S
    assert measured.seconds <= allowed + SAMPLE_S + measured.late_s, found


def running(session):
    """Whether the bridge measures the robot's own timeout."""
    replies = session.get("rover/base", payload=b"{}", timeout=1.0)
    return any(b'"running"' in reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None)


@pytest.mark.parametrize(("key", "number"), [("check-interrupted", SIGINT), ("check-killed", SIGKILL)])
def test_end_of_a_check_stops_a_robot_whose_timeout_is_measured(tmp_path, key, number):
    """The robot has no timeout of its own: only the bridge's zeros halt it."""
    model = ["--model", "turtlebot3-burger"]
    motion = load_description(model[1]).motion
    with Rig(tmp_path, COURSE, mock=["--ros2", *model], bridge=model, base_form=ROS2DDS) as rig:
        check = rig.start_process(lambda: Process("check", ["--robot", rig.robot, "--on-blocks"], tmp_path))
        wait_for(lambda: running(rig.watcher.session), 60.0, "the measurement")
        rig.late_s()
        began_ns, v = time.monotonic_ns(), rig.truth.speed()
        check.send_signal(number)
        seconds = rig.stood(began_ns)
        late_s, allowed = rig.late_s(), CHECK_S[key] + abs(v) / motion.decel + DELAY_S
    found = record(key, "ros2dds", seconds, allowed)
    assert abs(v) > 0.05
    assert late_s <= MAX_LATE_S
    assert seconds <= allowed + SAMPLE_S + late_s, found


def test_the_page_shows_every_row():
    page = PAGE.read_text().partition("## With a ROS 2 robot")[2]
    lines = [line for line in page.partition("\n## ")[0].splitlines() if line.startswith("| ")][1:]
    assert [line.split(" | ")[0].removeprefix("| ") for line in lines] == [
        ROWS[key].layer for key in (*KEYS, *CHECK_S)
    ]
