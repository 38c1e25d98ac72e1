"""``check`` as a process sees a healthy robot: its command, real time and Zenoh."""

import json

import pytest
from kit.bridge_bench import BRAKING_M_S2
from kit.json_fields import undescribed

from deploy.check import STANDING
from rover_ncp import cli
from sim.live.live_run import LiveRun


@pytest.mark.long
def test_a_robot_that_is_well(tmp_path, capsys):
    with LiveRun(tmp_path) as rig:
        code = cli.run(["check", "--robot", rig.robot, "--on-blocks", "--json"])
        said = json.loads(capsys.readouterr().out)
        stopped = rig.truth.stood_after(rig.truth.read()[-1].clock_ns)
        gate = rig.bridge.stop().result
    assert not undescribed("check", said)
    assert [finding for finding in said["findings"] if not finding["ok"]] == []
    assert (code, said["ready"]) == (0, True)
    assert len(said["findings"]) == 8
    # What it calls standing may still creep, for as long as braking from that takes.
    assert stopped <= STANDING / BRAKING_M_S2
    # The check's own pause. A busy machine adds others of the rules on late data, which the check allows for.
    assert {"silence"} <= gate["stops"].keys() <= {"silence", "odometry"}
