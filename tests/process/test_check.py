"""The command check with real processes: a mock, a bridge, and localisers and publishers beside them."""

import time

import numpy as np
import pytest
from kit.peer import Peer

from rover_ncp import cli
from rover_ncp.core.geometry import Pose, compose
from rover_ncp.wire.messages import pose_with_covariance, read_odometry
from rover_ncp.wire.zenoh import client_config

MAP = Pose(1.0, 2.0, 2.0)


class Localiser(Peer):
    """Publishes poses whose distances are ``scale`` times odometry's, and ``late_s`` late.

    Its clock is ``slow_s`` behind.
    """

    def __init__(self, rig, scale=1.0, late_s=0.0, slow_s=0.0):
        super().__init__(client_config(rig.robot, None)[0])
        self._scale, self._late_s, self._poses = scale, late_s, []
        self._slow_ns = round(slow_s * 1e9)
        self._held = self.session.declare_subscriber("odom", self._take)

    def _take(self, sample):
        self._poses.append((time.monotonic(), read_odometry(sample.payload.to_bytes()).pose))

    def run(self):
        while not self.closing.wait(0.05):
            past = [pose for at_s, pose in self._poses[-100:] if at_s <= time.monotonic() - self._late_s]
            if past:
                x, y, theta = past[-1]
                pose = compose(MAP, Pose(self._scale * x, self._scale * y, theta))
                data = pose_with_covariance(pose, 1e-4 * np.eye(3), time.time_ns() - self._slow_ns, "map")
                self.session.put("pose", data)


@pytest.mark.parametrize(
    ("localiser", "name", "words"),
    [
        ({}, "silence", "after the last command"),
        ({"scale": 0.5}, "pose-way", "is the size of tags or map wrong?"),
        ({"late_s": 0.7}, "pose-way", "stamp a pose with the time of its picture"),
    ],
)
def test_check_says_what_is_wrong_with_a_localiser(rig, run_json, localiser, name, words):
    with Localiser(rig, **localiser):
        code, fields = run_json(f"check --robot {rig.robot} --model p3at-sh --on-floor")
    last = fields["findings"][-1]
    assert (code, last["name"]) == (int(bool(localiser)), name), last["detail"]
    assert words in last["detail"]
    assert "in the frame map" in str(fields)
    time.sleep(1.5)  # the rover stands for the next test


def test_check_counts_publishers(rig, run_json):
    with Localiser(rig), Localiser(rig, slow_s=5.0):
        code, fields = run_json(f"check --robot {rig.robot} --on-blocks")
    last = fields["findings"][-1]
    assert (code, last["name"]) == (1, "odometry")
    assert "two publishers send pose" in last["detail"]


def test_check_names_the_namespaces_of_bridges(rig, capsys):
    assert cli.run(f"check --robot {rig.robot} --namespace bot1 --on-blocks".split()) == 3
    assert "bridges are announced in: no namespace (--namespace)" in capsys.readouterr().err
