"""A lab's localisation beside real processes: it gives the rover its start pose, and the rover parks."""

import numpy as np
import pytest

from deploy.replay import replay
from rover_ncp.core.geometry import Pose, compose, distance, wrap_angle
from rover_ncp.course.course import load_course
from rover_ncp.wire.key_table import key
from rover_ncp.wire.messages import pose_with_covariance
from rover_ncp.wire.zenoh import client_config
from sim.live.live_run import LiveRun
from sim.live.peers import Peer

COURSE = """
name: into-place
start_signal_s: 1.0
horizon_s: 16.0
checkpoints:
- {t: 0.0, x: 0.0, y: 0.0, theta: 0.0}
- {t: 1.0, x: 0.0, y: 0.0, theta: 0.0}
- {t: 3.0, x: 0.15, y: 0.0, theta: 0.0}
- {t: 5.0, x: 0.35, y: 0.03, theta: 0.2}
- {t: 7.0, x: 0.55, y: 0.07, theta: 0.2}
- {t: 9.0, x: 0.68, y: 0.09, theta: 0.1}
- {t: 16.0, x: 0.68, y: 0.09, theta: 0.1}
"""
SIGMA = np.array([0.005, 0.005, 0.0087])


class Localiser(Peer):
    """A simulated motion capture: the true pose with a small error, ten times a second."""

    def __init__(self, run, course_world, rng):
        super().__init__(client_config(run.robot, None)[0])
        self._truth, self._course_world, self._rng = run.truth, course_world, rng

    def run(self):
        while not self.closing.wait(0.1):
            states = self._truth.read()
            if states:
                error = SIGMA * self._rng.normal(size=3)
                pose = Pose(*np.add(compose(self._course_world, states[-1].pose), error))
                data = pose_with_covariance(pose, np.diag(SIGMA**2), states[-1].wall_ns, "course")
                self.session.put(key("", "pose"), data)


@pytest.mark.long
def test_a_rover_with_an_external_start_pose_parks_on_the_true_pose(tmp_path):
    rng = np.random.default_rng(1)
    start = Pose(*(rng.uniform(-1, 1, 3) * (0.1, 0.1, 0.17)))
    path = tmp_path / "into-place.yaml"
    path.write_text(COURSE)
    course, recording = load_course(path), tmp_path / "run.mcap"
    with LiveRun(tmp_path / "log") as run:
        with Localiser(run, start, rng):
            options = ["--policy", "course", "--course", str(path), "--pose", "required"]
            done = run.deploy(*options, "--record", str(recording)).wait(60)
        end = compose(start, run.truth.read()[-1].pose)
    assert done.code == 0, done
    assert done.result["pose"]["used"] > 50
    assert done.result["pose"]["refused"] == 0
    # Without external poses the final position error would be as large.
    assert distance(start, Pose(0, 0, 0)) > 0.05
    assert distance(end, course.goal) < course.parked.position_m / 2
    assert abs(wrap_angle(end.theta - course.goal.theta)) < course.parked.heading_rad
    assert replay(recording).difference is None
