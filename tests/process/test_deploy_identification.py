"""A live robot is identified: mock and bridge as processes."""

import pytest
from kit.identified import errors, robot, truth

from deploy.identify.excitation import steps
from rover_ncp.robot.profile import load_profile
from sim.park.live import LiveRun
from sim.world.randomization import load_randomization


@pytest.mark.long
def test_a_live_robot_is_identified(tmp_path, run_json, monkeypatch):
    # Half of the drive. A command that a busy machine loses spoils one of its steps, and three must be left.
    half = [*steps()[:9], *steps()[15:23]]
    for module in ("run", "excitation"):
        monkeypatch.setattr(f"deploy.identify.{module}.steps", lambda robot=None: half)
    with LiveRun(tmp_path / "log", mock=["--randomize", "full", "--seed", "4711", "--trial", "3"]) as live:
        code, fields = run_json(f"identify --robot {live.robot} --out {tmp_path}/a.yaml")
    assert code == 0
    profile = load_profile(tmp_path / "a.yaml")
    assert fields["delay_v_s"] == profile.delay_v_s
    ranges = load_randomization("full")
    off = errors(profile, truth(ranges, robot(ranges, 4711, 3)))
    assert max(abs(off[key].error) for key in ("delay_v_s", "delay_omega_s")) < 0.02
    assert max(abs(off[key].error) for key in ("gain_v", "gain_omega")) < 0.03
