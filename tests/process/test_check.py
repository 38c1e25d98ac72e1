"""The command check with real processes: a mock, a bridge, and a localiser beside them."""

import time

import numpy as np
import pytest
from kit.peer import Peer

from rover_ncp.core.geometry import ORIGIN, Pose, compose
from rover_ncp.wire.messages import pose_with_covariance, read_odometry
from rover_ncp.wire.zenoh import client_config

MAP = Pose(1.0, 2.0, 2.0)


STALL_S = 0.25
"""Shorter than the check's limits for odometry and commands, longer than two of the mock's reports apart."""
TRIES = 4


class Localiser(Peer):
    """Publishes poses whose distances are ``scale`` times odometry's."""

    def __init__(self, rig, scale):
        super().__init__(client_config(rig.robot, None)[0])
        self._scale, self._pose = scale, ORIGIN
        self._heard, self.stalled_s = time.monotonic(), 0.0
        """Longest time between samples of odometry: a stall of this computer, since the mock drops none."""
        self._held = self.session.declare_subscriber("odom", self._take)

    def _take(self, sample):
        self._pose = read_odometry(sample.payload.to_bytes()).pose
        heard, self._heard = self._heard, time.monotonic()
        self.stalled_s = max(self.stalled_s, self._heard - heard)

    def run(self):
        while not self.closing.wait(0.05):
            x, y, theta = self._pose
            pose = compose(MAP, Pose(self._scale * x, self._scale * y, theta))
            self.session.put("pose", pose_with_covariance(pose, 1e-4 * np.eye(3), time.time_ns(), "map"))


@pytest.mark.parametrize(
    ("scale", "name"), [pytest.param(1.0, "silence", marks=pytest.mark.long), (0.5, "pose-way")]
)
def test_check_ends_with_its_last_step_or_that_which_a_localiser_fails(rig, run_json, scale, name):
    for _ in range(TRIES):  # again if this computer stalled
        with Localiser(rig, scale) as localiser:
            code, fields = run_json(f"check --robot {rig.robot} --model p3at-sh --on-floor")
        last = fields["findings"][-1]
        time.sleep(1.5)  # the rover stands for the next one
        if (code, last["name"]) == (int(scale != 1.0), name) or localiser.stalled_s < STALL_S:
            break
    assert (code, last["name"]) == (int(scale != 1.0), name), (localiser.stalled_s, last["detail"])
    assert "in the frame map" in str(fields)
