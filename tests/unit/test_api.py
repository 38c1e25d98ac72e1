"""The Python API: what it returns, what it refuses, and what it loads."""

import subprocess
import sys

import numpy as np
import pytest
from kit.paths import DATA
from kit.recorded_drives import write_drive

import rover_ncp
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import load_course
from rover_ncp.recording.recording import Recorded, RecordingWriter
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.messages import (
    FLOATS,
    ODOMETRY,
    POSE_WITH_COVARIANCE,
    neurons,
    pose_with_covariance,
)
from sim.learn.rollout import rollout

SHORT = str(DATA / "short_course.yaml")


def test_a_recording_becomes_arrays_of_what_was_recorded(tmp_path):
    run = write_drive(tmp_path / "run.mcap")
    arrays = rover_ncp.read_arrays(tmp_path / "run.mcap")
    policy = rover_ncp.load_policy("parking")
    assert arrays["rover/neurons"].dtype.names == ("t", *policy.circuit.neurons)
    potentials = np.column_stack([arrays["rover/neurons"][name] for name in policy.circuit.neurons])
    assert np.array_equal(potentials, run.potentials)
    assert np.array_equal(np.column_stack([arrays["cmd_vel"]["v"], arrays["cmd_vel"]["omega"]]), run.commands)
    for name, column in zip(("x", "y"), run.poses.T[:2], strict=True):
        assert np.array_equal(arrays["truth/pose"][name], column)
    assert np.allclose(np.diff(arrays["truth/pose"]["t"]), 0.1)
    assert (arrays["rover/estimate"]["std_x"] > 0).all()
    assert "rover/status" not in arrays


def test_messages_that_cannot_be_read_are_left_out_and_counted(tmp_path, caplog):
    zero = encode(POSE_WITH_COVARIANCE)  # of a localiser before its first fix: no orientation
    fix = pose_with_covariance(Pose(1.0, 2.0, 0.0), np.eye(3), 1, "course")
    sent = [
        *(("pose", POSE_WITH_COVARIANCE, data) for data in (zero, fix, zero, fix)),
        *(("rover/neurons", FLOATS, data) for data in (neurons([], []), neurons([-50.0], ["AVA"]))),
        ("odom", ODOMETRY, b""),
    ]
    with RecordingWriter(tmp_path / "run.mcap") as writer:
        for number, (topic, ros_type, data) in enumerate(sent):
            writer.write(Recorded(topic, ros_type, data, 10**9 * (number + 1), 1))
    arrays = rover_ncp.read_arrays(tmp_path / "run.mcap")
    assert arrays["pose"][["t", "x"]].tolist() == [(1.0, 1.0), (3.0, 1.0)]
    assert arrays["rover/neurons"].tolist() == [(5.0, -50.0)]
    assert "odom" not in arrays
    counts = {tuple(record.args[1:3]) for record in caplog.records}
    assert counts == {("odom", 1), ("rover/neurons", 1), ("pose", 2)}


def test_training_calls_back_and_its_policy_can_be_evaluated(tmp_path):
    seen = []
    settings = {"course": SHORT, "seed": 1, "agents": 2, "iterations": 20}
    result = rover_ncp.train(settings, str(tmp_path / "run"), processes=1, on_progress=seen.append)
    assert seen[-1].returns == result.agents.returns
    again = rover_ncp.load_policy(result.policy_path)
    assert rollout(again, load_course(SHORT)).total == pytest.approx(result.agents.best.value)
    assert rover_ncp.evaluate(again, [SHORT, SHORT], trials=2, randomize="full").trials == 2


def test_a_setting_that_does_not_exist_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"agens: unknown key"):
        rover_ncp.train({"agens": 3}, tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("line", "heavy"),
    [
        ("import rover_ncp", "sim numpy pydantic scipy pymunk gymnasium matplotlib zenoh rosbags"),
        (
            "import rover_ncp; rover_ncp.load_policy('course')",
            "scipy zenoh rosbags mcap pymunk gymnasium matplotlib sim",
        ),
    ],
)
def test_nothing_is_loaded_that_is_not_used(line, heavy):
    program = f"{line}; import sys; print(sorted(set({heavy.split()}) & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=50, check=True
    )
    assert done.stdout == "[]\n"
