"""A random trial as real processes, beside the same on a virtual clock."""

import time

import pytest
from kit.paths import DATA
from kit.peer import Peer

from deploy.replay import replay
from deploy.view.recorded_drive import read_drive
from deploy.zenoh_client import client_config
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.geometry import distance, wrap_angle
from rover_ncp.course.course import load_course
from rover_ncp.recording.recording import read_recording, rewrite
from rover_ncp.wire.key_table import key
from rover_ncp.wire.messages import read_text, text
from rover_ncp.wire.protocol import GateStatus, parse_json
from sim.learn.policies import any_policy
from sim.park.live import LiveRun
from sim.park.truth import during, recorded_truth
from sim.stack.camera import PLACED, start_pose
from sim.stack.trials import Stack
from sim.world.randomization import load_randomization

pytestmark = pytest.mark.timed

SHORT, SEED = DATA / "short_course.yaml", 4


class StartPosePublisher(Peer):
    """External localisation of a rover that stands at ``pose``, until a driver has the lease."""

    def __init__(self, robot, pose):
        super().__init__(client_config(robot, None)[0])
        self._pose = pose
        self._gate = self.session.declare_subscriber(key("", "rover/gate"), self._receive_gate)

    def run(self):
        while not self.closing.wait(0.1):
            self.session.put(key("", "pose"), start_pose(self._pose, time.time_ns()))
            self.session.put(key("", "rover/localiser"), text(PLACED.model_dump_json()))

    def _receive_gate(self, sample):
        if parse_json(GateStatus, read_text(sample.payload.to_bytes())).lease:
            self.closing.set()


def test_live_and_virtual_trials_end_at_the_same_pose(tmp_path):
    course, ranges = load_course(SHORT), load_randomization("full")
    stack = Stack(any_policy("course"), (course,), ranges, SEED)
    # The driver knows the noise of its odometry and its start pose, and nothing else.
    assert set(stack.known.model_dump(exclude_none=True)) == {
        *("format", "name", "noise_m", "noise_rad", "std", "measured")
    }
    assert stack.known.std == {}
    profile, recording = tmp_path / "driver.yaml", tmp_path / "run.mcap"
    profile.write_text(dump_yaml(stack.known.model_dump(mode="json", exclude_none=True)))
    mock = ["--course", str(SHORT), "--randomize", "full", "--trial", "0", "--seed", str(SEED)]
    with LiveRun(tmp_path / "log", mock=mock) as run:
        with StartPosePublisher(run.robot, stack.drawn(0).rover.pose):
            driver = run.deploy(
                *("--policy", "course", "--course", str(SHORT), "--profile", str(profile)),
                *("--pose", "required", "--record", str(recording)),
            )
            done = driver.wait(course.horizon_s + 180.0)
        bridge = run.bridge.stop().result
        run.mock.stop()
    # The short course ends while the rover moves: the poses at that time are compared.
    assert done.code in {0, 1}, done.last_line
    assert done.result["stopped_by"] is None
    assert bridge["accepted"] > 20
    truth = run.truth.read()
    rewrite(read_recording(recording), recording, recorded_truth(truth))
    began_ns = read_drive(recording).timeline.ticks[0].wall_ns
    live, virtual = during(course, truth, began_ns)[-1].pose, stack.drive(0).pose
    # The rover still moves at 0.1 m/s then, so a delay of the last sample is a distance.
    assert distance(live, virtual) < 0.02
    assert abs(wrap_angle(live.theta - virtual.theta)) < 0.05
    found = read_recording(recording)
    assert len(found.topic("truth/pose")) > 400
    assert found.topic("pose")
    assert replay(recording).difference is None
