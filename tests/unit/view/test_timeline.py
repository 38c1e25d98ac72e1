import numpy as np
import pytest
from kit.recorded_drives import state, write_drive

from deploy.view.recorded_drive import read_drive
from deploy.view.timeline import Timeline
from rover_ncp.neurons.findings import analyse
from rover_ncp.wire.protocol import DriverStatus, GateStatus

SHORT = "tests/data/short_course.yaml"


def timeline_of(short, messages):
    timeline = Timeline(short.policy, short.course)
    for message in messages:
        timeline.take(message)
    return timeline


def test_a_drive_gives_back_the_run_it_was_recorded_from(short):
    timeline, run = timeline_of(short, short.messages), short.run
    assert np.allclose(timeline.ticks[3].estimate.covariance, np.diag([4e-6, 8e-6, 4e-6]))
    trace = timeline.traces()[0]
    assert trace.times == pytest.approx(run.times[:-1])
    assert trace.poses == pytest.approx(run.poses)
    assert (trace.potentials == run.potentials).all()
    assert trace.commands == pytest.approx(run.commands, abs=1e-12)
    on_course = np.array([timeline.on_course(moved.pose) for moved in timeline.odometry])
    assert on_course == pytest.approx(run.poses, abs=1e-9)
    assert timeline.truth[-1].pose == pytest.approx(run.poses[-1])
    # The gate held the rover before its first command.
    assert not any(event.kind == "stop" for event in timeline.events)


def test_events_are_the_changes_of_driver_and_gate(short):
    held = {"accepted": 13, "held": "stopped"}
    states = [
        DriverStatus(state="driving"),
        GateStatus(accepted=9, held="no-lease"),
        GateStatus(lease=1, accepted=11, held="bumper"),
        GateStatus(lease=1, accepted=11, held="bumper"),
        GateStatus(lease=1, accepted=12),
        DriverStatus(state="driving", tick=14, overruns=1),
        DriverStatus(state="driving", tick=16, overruns=2),
        GateStatus(lease=1, accepted=13, dropped={"stale": 1}),
        GateStatus(lease=1, **held, stop_reason="a person"),
        GateStatus(lease=1, **held, ended="stopped"),
        DriverStatus(state="fault", reason="stopped by lease"),
    ]
    received = [state(each, number) for number, each in enumerate(states, 1)]
    assert timeline_of(short, received).events == [
        (1, "state", "driving"),
        (3, "stop", "the gate holds the rover, bumper"),
        (5, "gate", "the gate passes commands again"),
        (6, "late", "tick 14 was late: this computer was busy; the drive went on; 1 more within 0.0 s"),
        (8, "gate", "the gate dropped a command for the first time, stale"),
        (9, "stop", "the gate holds the rover, stopped: a person"),
        (10, "stop", "the gate revoked the lease, stopped"),
        (11, "stop", "fault: stopped by lease"),
    ]


@pytest.mark.parametrize("truth", [True, False])
def test_drive_is_judged_by_the_true_and_the_estimated_pose(tmp_path, truth):
    run = write_drive(tmp_path / "run.mcap", course=SHORT, truth=truth)
    drive = read_drive(tmp_path / "run.mcap")
    assert not drive.damage
    assert drive.settings["version"] == "0.1.0"
    verdicts = drive.timeline.judge()
    assert list(verdicts) == ["true", "estimated"][not truth :]
    for verdict in verdicts.values():
        assert verdict.error_m == pytest.approx(run.verdict.error_m)
        assert verdict.parked is run.verdict.parked


def test_motion_of_another_stage_is_no_motion_of_a_policy(short):
    """A way to the staging pose, an approach, and a second way: each third of a drive."""
    ticks = len(short.run.commands)
    stages = ["NAV_TO_STAGING_POSE, try 1 of 2", "CONTROLLING, try 1 of 2", "NAV_TO_STAGING_POSE, try 2 of 2"]
    timeline = Timeline(short.policy, short.course, short.policy)
    for message in short.messages:
        timeline.take(message)
        if message.topic == "rover/neurons":
            stage = stages[3 * (len(timeline.ticks) - 1) // ticks]
            timeline.take(state(DriverStatus(state=stage), message.log_ns))
    phases = analyse(*timeline.traces()).phases
    steps = np.hypot(*np.diff(short.run.poses[:, :2], axis=0).T)
    assert sum(phase.driven_m for phase in phases) == pytest.approx(steps.sum())
    ends = [0.1 * np.ceil(third * ticks / 3) for third in (1, 2)]
    assert not [phase for phase in phases if any(phase.start_s < end < phase.end_s for end in ends)]
