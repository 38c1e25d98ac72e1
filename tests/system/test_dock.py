"""The whole way to a place: camera, tags, bridge and driver as processes, one approach blocked."""

import pytest

from sim.park.live import Process

pytestmark = pytest.mark.long


def test_dock_is_found_by_tags_after_a_blocked_approach_and_replays(tmp_path):
    done = Process("park", ["--dock", "--out", str(tmp_path / "dock"), "--json"], tmp_path).wait(400.0)
    assert done.code == 0, done.last_line
    assert done.result["docked"]
    assert done.result["tries"] >= 2
    assert done.result["poses"] > 50
    errors = done.result["true_errors"]
    assert abs(errors["lateral_m"]) < 0.02
    assert abs(errors["longitudinal_m"]) < 0.02
    replayed = Process("replay", [done.result["recording"], "--json"], tmp_path).wait(120.0)
    assert replayed.result["same"]
    assert "Docked at bay" in (tmp_path / "dock" / "run.html").read_text()
