"""Drives to a place through firmware, gate and driver: how they end, and that they are replayed exactly."""

import pytest
from kit.virtual_docking import VirtualDocking, place

from deploy.place.outcome import DockError
from deploy.replay import replay
from deploy.view.recorded_drive import read_drive, summarise
from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import Obstacle

START = Pose(1.05, 1.12, -0.5)
DOCK = Obstacle(x=2.365, y=1.0, length=0.1, width=0.6)
"""A wall that the front of a Pioneer 3-AT reaches at the place."""


@pytest.fixture(scope="module")
def docked(tmp_path_factory):
    path = tmp_path_factory.mktemp("docked") / "docked.mcap"
    drive = VirtualDocking(place(), START, path=path)
    drive.run()
    return drive


def test_rover_docks_within_the_tolerances_by_its_true_pose(docked):
    ahead, left, turned = docked.off
    assert docked.result.dock.success
    assert docked.result.exit_code == 0
    assert (ahead**2 + left**2) ** 0.5 < 0.02
    assert abs(turned) < 0.035
    assert docked.result.dock.by_estimate.longitudinal_m == pytest.approx(ahead, abs=0.003)
    assert docked.result.dock.by_proof.lateral_m == pytest.approx(left, abs=0.003)


def test_docking_is_replayed_to_the_last_bit(docked):
    found = replay(docked.path)
    assert found.same, found
    assert found.ticks > 300


def test_report_names_the_place_and_how_it_ended(docked):
    assert "docked" in summarise(read_drive(docked.path)).headline.lower()


def test_contact_at_the_place_proves_a_docking_and_is_replayed(tmp_path):
    drive = VirtualDocking(place(proof="contact"), START, path=tmp_path / "c.mcap", obstacles=[DOCK])
    result = drive.run()
    assert result.dock.success, result.dock
    assert abs(drive.off[1]) < 0.02
    assert replay(drive.path).same


def test_contact_elsewhere_is_a_miss_and_the_rover_backs_out(tmp_path):
    blocked = DOCK.model_copy(update={"x": 2.15})
    drive = VirtualDocking(
        place(retries=1, proof="contact"), START, path=tmp_path / "c.mcap", obstacles=[blocked]
    )
    result = drive.run()
    assert not result.dock.success
    assert (result.exit_code, result.dock.error_code) == (1, DockError.FAILED_TO_CONTROL)
    assert (result.dock.num_retries, result.dock.at) == (1, "staging pose")
    assert replay(drive.path).same
