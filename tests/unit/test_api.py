"""The Python API: what it returns, what it refuses, and what it loads."""

import subprocess
import sys

import numpy as np
import pytest
from kit.paths import DATA
from kit.recorded_drives import write_drive

import rover_ncp
from rover_ncp.course.course import load_course
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


def test_training_calls_back_and_its_policy_can_be_evaluated(tmp_path):
    seen = []
    settings = {"course": SHORT, "seed": 1, "agents": 2, "iterations": 20}
    result = rover_ncp.train(settings, str(tmp_path / "run"), processes=1, on_progress=seen.append)
    assert seen[-1].returns == result.agents.returns
    again = rover_ncp.load_policy(result.policy_path)
    assert rollout(again, load_course(SHORT)).total == pytest.approx(result.agents.best.value)
    assert rover_ncp.evaluate(again, [SHORT, SHORT], trials=2, randomize="full").trials == 2


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
