"""A live row of the safety matrices. `make test-timed` measures all rows."""

from faults.measure import measure, require_in_time
from faults.rig import Rig
from faults.table import ROWS
from kit.paths import DATA

from sim.park.live import ROS2DDS

HUSKY = {"base_form": ROS2DDS, "model": "husky-a200", "bridge": ["--no-base-watchdog"]}


def test_robot_whose_bridge_is_killed_stands_in_time_and_stays(tmp_path):
    with Rig(tmp_path, DATA / "prompt_course.yaml", **HUSKY) as rig:
        require_in_time(measure(rig, ROWS["bridge-killed"], ROWS["bridge-killed"].drivers[0]))
