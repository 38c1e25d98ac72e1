"""Two live rows of the safety matrices, one of each robot. `make test-timed` measures all rows."""

import pytest
from faults.measure import measure, require_in_time
from faults.rig import Rig
from faults.table import ROWS
from kit.paths import DATA

from sim.park.live import ROS2DDS

HUSKY = {"base_form": ROS2DDS, "model": "husky-a200", "bridge": ["--no-base-watchdog"]}


@pytest.mark.parametrize(("options", "key"), [({}, "deploy-killed"), (HUSKY, "bridge-killed")])
def test_the_rover_stands_in_time_and_stays(options, key, tmp_path):
    with Rig(tmp_path, DATA / "prompt_course.yaml", **options) as rig:
        require_in_time(measure(rig, ROWS[key], ROWS[key].drivers[0]))
