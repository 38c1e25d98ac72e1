"""A peer without keys that publishes an input of the driver, too: real processes, and a dry run."""

import time

import numpy as np
import pytest
from kit.bridge_bench import Rig

from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.wire.messages import imu, odometry, pose_with_covariance, read_text
from rover_ncp.wire.protocol import DriverStatus, parse_json
from rover_ncp.wire.zenoh import client_config
from sim.live.peers import Peer

STANDS = Pose(0.0, 0.0, 0.0)
FALSE = {
    "odom": lambda now_ns: odometry(STANDS, Velocity(0.0, 0.0), now_ns),
    "imu": lambda now_ns: imu(0.0, 1e-6, now_ns),
    "pose": lambda now_ns: pose_with_covariance(STANDS, np.eye(3) * 1e-4, now_ns, "course"),
}


class Publisher(Peer):
    """Publishes on one key ten times a second, stamped by a clock that is ``late_s`` behind."""

    def __init__(self, robot, name, late_s):
        super().__init__(client_config(robot, None)[0])
        self._name, self._late_ns = name, round(late_s * 1e9)

    def run(self):
        while not self.closing.wait(0.1):
            self.session.put(self._name, FALSE[self._name](time.time_ns() - self._late_ns))


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    with Rig(tmp_path_factory.mktemp("rig")) as rig:
        yield rig


def dry_run(rig, *publishers):
    """Return the result of a dry run, its log, and the warnings on ``rover/status``."""
    peers = [Publisher(rig.robot, name, late_s).start() for name, late_s in publishers]
    listener, heard = Publisher(rig.robot, "pose", 0.0), []
    held = listener.session.declare_subscriber(
        "rover/status",
        lambda sample: heard.append(parse_json(DriverStatus, read_text(sample.payload.to_bytes())).warning),
    )
    try:
        process = rig.deploy("--dry-run", "--duration", "2")
        done = process.wait(60)
    finally:
        for peer in [*peers, listener]:
            peer.close()
    assert held is not None
    log = max(rig.folder.rglob("deploy.log"), key=lambda path: path.stat().st_mtime_ns).read_text()
    return done.result, log, {warning for warning in heard if warning}


@pytest.mark.parametrize(
    ("publishers", "named"),
    [
        ([("odom", 0.0)], "two publishers send odom"),
        ([("imu", 0.0)], "two publishers send odom and imu"),
        ([("pose", 0.0), ("pose", 5.0)], "two publishers send pose"),
    ],
)
def test_a_second_publisher_is_in_the_log_the_status_and_the_result(rig, publishers, named):
    result, log, warnings = dry_run(rig, *publishers)
    assert named in result["warning"]
    assert f"warning: {named}" in log
    assert any(named in warning for warning in warnings)


def test_one_publisher_of_each_is_no_warning(rig):
    result, log, warnings = dry_run(rig, ("pose", 0.0))
    assert (result["warning"], warnings) == (None, set())
    assert "warning" not in log
