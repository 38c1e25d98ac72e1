"""The safety matrix with a ROS 2 robot behind the bridge: the rows whose fault such a robot can have.

Where the bridge lives, the bounds are those of the Pioneer. Where it is dead, hung or cut off from the robot,
the robot's own timeout stops it. Braking is that of its description.
"""

import pytest
from faults.measure import measure, require_in_time, time_stop
from faults.rig import Rig
from faults.table import CHECKS, ROS2_KEYS, ROWS
from kit.paths import DATA

from sim.live.live_run import RMW_ZENOH, ROS2DDS
from sim.live.processes import READY_TIMEOUT_S, Process, wait_for

pytestmark = pytest.mark.timed

COURSE = DATA / "prompt_course.yaml"


@pytest.fixture(
    scope="module",
    params=[pytest.param(form, marks=pytest.mark.xdist_group(form)) for form in (ROS2DDS, RMW_ZENOH)],
    ids=["ros2dds", "rmw-zenoh"],
)
def rig(request, tmp_path_factory):
    form = request.param
    folder = tmp_path_factory.mktemp("rig")
    with Rig(folder, COURSE, bridge=["--no-base-watchdog"], base_form=form, model="husky-a200") as rig:
        rig.form = "rmw_zenoh" if form == RMW_ZENOH else "ros2dds"
        yield rig


@pytest.mark.parametrize("key", ROS2_KEYS)
def test_the_robot_stands_in_time_and_stays(rig, key):
    require_in_time(measure(rig, ROWS[key], ROWS[key].drivers[0]), rig.form)


def running(session):
    """Whether the bridge measures the robot's own timeout."""
    replies = session.get("rover/base", payload=b"{}", timeout=1.0)
    return any(b'"running"' in reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None)


@pytest.mark.parametrize(("key", "number"), CHECKS.items())
def test_end_of_a_check_stops_a_robot_whose_timeout_is_measured(tmp_path, key, number):
    """The robot has no timeout of its own: only the bridge's zeros halt it."""
    with Rig(tmp_path, COURSE, base_form=ROS2DDS, model="turtlebot3-burger") as rig:
        check = rig.start_process(lambda: Process("check", ["--robot", rig.robot, "--on-blocks"], tmp_path))
        wait_for(lambda: running(rig.watcher.session), READY_TIMEOUT_S, "the measurement")
        speed = rig.truth.speed()
        measured = time_stop(rig, ROWS[key], lambda: check.send_signal(number))
    assert abs(speed) > 0.05
    require_in_time(measured, "ros2dds")
