"""Drives to a place through firmware, gate and driver: how they end, and that they are replayed exactly."""

import math

import pytest
from kit.virtual_docking import BEFORE_STAGING, STAGING, VirtualDocking, place

from deploy.drive.tick_messages import FRAMES_TOPIC, PATH_TOPIC, POSE_TOPIC
from deploy.place.outcome import DockError
from deploy.replay import replay
from deploy.view.recorded_drive import read_drive, summarise
from rover_ncp.core.geometry import Pose, distance, turned
from rover_ncp.course.course import Obstacle
from rover_ncp.wire.cdr import decode
from rover_ncp.wire.messages import (
    battery_state,
    bumpers,
    read_battery,
    read_bumpers,
    read_pose,
)

DOCK = Obstacle(x=2.365, y=1.0, length=0.1, width=0.6)
"""A wall that the front of a Pioneer 3-AT reaches at the place."""
BEFORE = DOCK.model_copy(update={"x": 2.15})


def lost_near(pose, now):
    """What a localiser sends that loses the rover before the place."""
    return pose if pose.x < 1.65 else None


def drove_m(drive):
    return distance(drive.rover.pose, drive.start)


@pytest.fixture(scope="module")
def docked(tmp_path_factory):
    path = tmp_path_factory.mktemp("docked") / "docked.mcap"
    drive = VirtualDocking(place(), BEFORE_STAGING, path=path)
    drive.run()
    return drive


@pytest.fixture(scope="module")
def read(docked):
    return read_drive(docked.path)


def test_rover_docks_within_the_tolerances_by_its_true_pose(docked):
    ahead, left, turned = docked.off
    assert (docked.result.dock.success, docked.result.exit_code) == (True, 0)
    assert (ahead**2 + left**2) ** 0.5 < 0.02
    assert abs(turned) < 0.035
    assert docked.result.dock.by_estimate.longitudinal_m == pytest.approx(ahead, abs=0.003)
    assert docked.result.dock.by_proof.lateral_m == pytest.approx(left, abs=0.003)


def test_poses_of_a_docking_are_in_the_places_frame(docked):
    estimates = [read_pose(data).frame for data in docked.messages("rover/estimate")]
    views = {
        message.topic: decode(message.type, message.data)
        for message in docked.recorded
        if message.topic in {POSE_TOPIC, PATH_TOPIC, FRAMES_TOPIC}
    }
    headers = [views[POSE_TOPIC].header, views[PATH_TOPIC].header, views[FRAMES_TOPIC].transforms[0].header]
    assert {*estimates, *(header.frame_id for header in headers)} == {"map"}


def test_docking_is_replayed_to_the_last_bit(docked):
    found = replay(docked.path)
    assert found.same, found
    assert found.ticks > 300


def test_report_names_the_place_and_how_it_ended(read):
    summary = summarise(read)
    rows = dict(summary.rows)
    assert "docked" in summary.headline.lower()
    assert summary.subline.startswith("policies course (to the staging pose) and dock at place ")
    assert rows["Ended as"] == "docked"
    assert rows["Estimate"].endswith(
        " mm from the true position in 95 % of drives; this is no error of the docking"
    )
    states = [event.text for event in read.timeline.events if event.kind == "state"]
    assert states[-1] == "docked"


def test_contact_elsewhere_is_a_miss_and_the_rover_backs_out(tmp_path):
    where = place(retries=1)
    drive = VirtualDocking(where, STAGING, path=tmp_path / "c.mcap", obstacles=[BEFORE])
    result = drive.run()
    assert not result.dock.success
    assert (result.exit_code, result.dock.error_code) == (1, DockError.FAILED_TO_CONTROL)
    assert (result.dock.num_retries, result.dock.at) == (1, "staging pose")
    assert replay(drive.path).same


@pytest.mark.parametrize("direction", ["forward", "backward"])
def test_after_a_miss_the_rover_goes_further_by_what_it_was_short_of(direction):
    where = place(direction=direction, position_m=0.008, retries=1)
    drive = VirtualDocking(where, where.staging)
    result = drive.run()
    assert (result.dock.success, result.dock.num_retries) == (True, 1)
    assert abs(drive.off[0]) < 0.004


def bumped(drive, pressed):
    """Let a front bumper be pressed when ``pressed(pose, now)`` says so."""
    observe = drive.base.observe

    def observed(now):
        observe(now)
        drive.base.panel.front_bumpers = 4 if pressed(drive.rover.pose, now) else 0

    drive.base.observe = observed
    return drive


class Since:
    """Seconds since the rover was first at ``x`` or beyond; None before."""

    def __init__(self, x):
        self.x, self.first_s = x, None

    def __call__(self, pose, now):
        if self.first_s is None and pose.x >= self.x:
            self.first_s = now
        return None if self.first_s is None else now - self.first_s

    def briefly(self, pose, now):
        """Whether it was there less than 0.3 s ago for the first time."""
        return (s := self(pose, now)) is not None and s < 0.3


def test_contact_of_the_other_end_is_no_dock():
    since = Since(1.95)
    drive = VirtualDocking(place(retries=0), STAGING)
    drive.link.change["bumpers"] = lambda data: bumpers(*reversed(read_bumpers(data)))
    result = bumped(drive, since.briefly).run()
    assert (result.exit_code, result.stopped_by, result.dock.success) == (4, "bumper", False)


def test_bumper_that_opens_and_closes_in_the_dock_does_not_end_the_wait_for_the_charge():
    since = Since(1.99)
    where = place(proof="charging", retries=0)
    drive = VirtualDocking(where, STAGING)
    bumped(drive, lambda pose, now: (s := since(pose, now)) is not None and not 1.0 < s < 1.3)
    drive.link.change["battery_state"] = lambda data: battery_state(
        12.5,
        read_battery(data).stamp_ns,
        charging=since.first_s is not None and drive.bridge.monotonic() - since.first_s > 5.0,
    )
    result = drive.run()
    assert (result.exit_code, result.dock.success, result.dock.num_retries) == (0, True, 0)


@pytest.mark.parametrize(("again_s", "code"), [(0.4, 0), (3.0, 4)])
def test_bumper_may_bounce_as_the_rover_begins_to_undock(again_s, code):
    drive, left_s = VirtualDocking(place(), Pose(2.0, 1.0, 0.0), undock=True), []

    def pressed(pose, now):
        if pose.x < 1.9995 and not left_s:
            left_s.append(now)
        gone_s = now - left_s[0] if left_s else 0.0
        return gone_s < 0.1 or again_s <= gone_s < again_s + 0.2

    assert bumped(drive, pressed).run().exit_code == code


def test_dry_run_plans_the_way_and_moves_nothing():
    drive = VirtualDocking(place(), BEFORE_STAGING, dry_run=True)
    result = drive.run()
    assert (result.exit_code, result.dock.success, result.verdict) == (0, False, "not parked")
    assert "the dry run ends after the first way (staging, " in result.dock.error_msg
    assert (drive.link.requests, drive.link.sent, drove_m(drive)) == (0, [], 0.0)
    without_way = VirtualDocking(place(), Pose(-3.0, 1.0, 0.0), dry_run=True).run()
    assert (without_way.exit_code, without_way.stopped_by) == (4, "start-pose")


BACKWARD = place(direction="backward")


@pytest.mark.parametrize(
    ("where", "start", "world"),
    [
        pytest.param(place(), BEFORE_STAGING, {"see": lost_near}, id="odometry replaces poses lost near"),
        pytest.param(BACKWARD, Pose(2.9, 0.9, 0.4), {}, id="backward"),
    ],
)
def test_docking_ends_within_the_tolerances_and_is_replayed(tmp_path, where, start, world):
    drive = VirtualDocking(where, start, path=tmp_path / "run.mcap", **world)
    dock = drive.run().dock
    assert dock.success, dock
    assert (dock.by_proof is None) == (world.get("see") is lost_near)
    assert max(map(abs, drive.off[:2])) < 0.02
    assert replay(drive.path).same


def test_constant_error_of_the_localisers_heading_cancels(tmp_path):
    error = math.radians(3.0)
    taught = place(pose={"x": 2.0, "y": 1.0, "theta": error})
    path = tmp_path / "run.mcap"
    drive = VirtualDocking(taught, BEFORE_STAGING, path=path, see=lambda pose, now: turned(pose, error))
    dock = drive.run().dock
    assert dock.success, dock
    assert abs(drive.rover.pose.theta) < math.radians(1.0)
    assert replay(path).same


def test_rover_that_stands_docked_stays_and_undocks_to_the_staging_pose(tmp_path):
    docked = VirtualDocking(BACKWARD, Pose(2.005, 1.0, 0.01))
    assert docked.run().dock.success
    assert drove_m(docked) < 0.002
    away = VirtualDocking(BACKWARD, Pose(2.0, 1.0, 0.0), path=tmp_path / "away.mcap", undock=True)
    assert away.run().dock.success
    assert away.off[0] == pytest.approx(0.7, abs=0.05)
    assert replay(away.path).same


def test_undocking_from_contact_without_any_pose_is_uncertain_and_its_words_say_so(tmp_path):
    unseen = {"obstacles": [DOCK], "see": lambda pose, now: None, "undock": True}
    drive = VirtualDocking(place(), Pose(2.0, 1.0, 0.0), path=tmp_path / "away.mcap", **unseen)
    result = drive.run()
    assert (result.dock.success, result.pose.placed, result.verdict) == (True, False, "parked, uncertain")
    assert drive.off[0] == pytest.approx(-0.7, abs=0.05)
    docking, verdict, *_ = result.words.splitlines()
    assert docking.startswith("undocked from bay")
    assert verdict.startswith("parked, uncertain: within the tolerances with a probability of ")
    summary = summarise(read_drive(drive.path))
    assert summary.parked == "parked, uncertain"
    assert summary.headline.startswith("Undocked from bay, uncertain: within the tolerances with ")


def test_drive_that_begins_in_the_line_of_approach_checks_its_obstacles_too():
    where = place(obstacles=[{"x": 1.3, "y": 1.1, "length": 0.1, "width": 0.3}])
    drive = VirtualDocking(where, Pose(1.5, 1.0, 0.0))
    result = drive.run()
    assert (result.exit_code, result.stopped_by, drove_m(drive)) == (4, "start-pose", 0.0)
    assert "the approach touches obstacle 1" in result.reason


def test_rover_elsewhere_does_not_undock():
    result = VirtualDocking(place(), BEFORE_STAGING, undock=True).run()
    assert (result.exit_code, result.stopped_by) == (4, "start-pose")
    assert "does not stand in bay" in result.reason
