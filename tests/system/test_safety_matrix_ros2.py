"""The safety matrix with a ROS 2 robot behind the bridge: the rows whose fault such a robot can have.

Where the bridge lives, the bounds are those of the Pioneer. Where it is dead, hung or cut off from the robot,
the robot's own timeout stops it. Braking is that of its description.
"""

import pytest
from faults.measure import measure, require_in_time
from faults.rig import Rig
from faults.table import ROS2_KEYS, ROWS
from kit.paths import DATA

from sim.park.live import RMW_ZENOH, ROS2DDS

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
