"""The safety matrix: every fault at every layer, with real processes, and the measured time to standstill.

The bounds are the requirement itself: 0.5 s plus braking, and the base's watchdog (2 s) plus braking where
the bridge is dead or hung, or cut off from its base. What the machine adds to bridge and driver has to fit
in; what it adds to the mock and the line to it is the measurement's (`faults.measure`).
"""

import functools
import math
import signal
import time
from contextlib import ExitStack

import numpy as np
import pytest
from faults.going_on import GOES_ON_S
from faults.hang import CLOCK_STEPS_S
from faults.measure import measure, require_in_time, time_stop
from faults.rig import CREEP_M_S, SPEED_M_S, Rig
from faults.table import MATRIX, ROWS
from kit.paths import DATA
from kit.peer import Peer
from kit.true_motion import speed

from rover_ncp.core.geometry import relative, wrap_angle
from rover_ncp.wire.key_table import key
from rover_ncp.wire.messages import COURSE_FRAME, pose_with_covariance, read_pose
from rover_ncp.wire.zenoh import client_config
from sim.park.live import READY_TIMEOUT_S, wait_for

pytestmark = [pytest.mark.timed, pytest.mark.xdist_group("matrix")]

COURSE, WALL = DATA / "prompt_course.yaml", DATA / "wall_course.yaml"


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    with Rig(tmp_path_factory.mktemp("rig"), COURSE) as rig:
        yield rig


@pytest.fixture(scope="module")
def rig_with(tmp_path_factory):
    """Return mock and bridge whose output goes to an outlet of a kind: one rig for each kind."""
    with ExitStack() as rigs:
        yield functools.cache(
            lambda outlet: rigs.enter_context(Rig(tmp_path_factory.mktemp("rig"), COURSE, outlet=outlet))
        )


KEYS = [each.key for each in MATRIX if each.act and not each.outlet]


# A scripted driver never stops by itself, so where one can drive, the gate stops the rover.
@pytest.mark.parametrize("key", KEYS)
def test_the_rover_stands_in_time_and_stays(rig, key):
    measured = measure(rig, ROWS[key], ROWS[key].drivers[0])
    require_in_time(measured)
    if key == "odometry-jumps":  # which the gate lets pass
        assert measured.stopped_by == "estimator"


@pytest.mark.parametrize("key", [each.key for each in MATRIX if each.outlet])
def test_blocked_output_delays_no_stop(rig_with, key):
    test_the_rover_stands_in_time_and_stays(rig_with(ROWS[key].outlet), key)


def test_two_deploys_at_once_of_which_the_second_is_refused(rig):
    deploys = [rig.drive_course() for _ in range(2)]
    wait_for(lambda: not all(deploy.running for deploy in deploys), READY_TIMEOUT_S, "a refusal")
    second, first = sorted(deploys, key=lambda deploy: deploy.running)
    done = second.wait(15.0)
    assert (done.code, done.result["kind"]) == (3, "AnotherDriver")
    rig.driven(first)
    first.send_signal(signal.SIGTERM)
    assert first.wait(15.0).code == 130
    rig.stood(time.monotonic_ns())


def test_a_wall_in_the_way(tmp_path):
    limits = tmp_path / "limits.yaml"
    limits.write_text("sonar_stop_m: 0.6\n")
    # The wall is 1 m ahead; two sonars 0.245 m before the centre look at it, 10 degrees from straight on.
    near_m = 1.0 - 0.245 - 0.6 * math.cos(math.radians(10.0))
    options = {"mock": ["--course", str(WALL)], "bridge": ["--limits", str(limits)]}
    with Rig(tmp_path, WALL, **options) as rig:
        driver = rig.under_way(rig.scripted_driver())
        near = wait_for(lambda: next((state for state in rig.truth.read() if state.pose.x >= near_m), None))
        require_in_time(time_stop(rig, ROWS["wall"], lambda: near.clock_ns))
        assert (driver.gate.held, driver.gate.stops["sonar"]) == ("sonar", 1)
        assert driver.driving
        rig.under_way(driver, -SPEED_M_S)  # and back is free


def test_fence_is_lost_when_the_base_restarts(tmp_path):
    limits = tmp_path / "limits.yaml"
    limits.write_text("fence: {x_min: -5, x_max: 5, y_min: -5, y_max: 5}\n")
    with Rig(tmp_path, COURSE, bridge=["--limits", str(limits)]) as rig:
        driver = rig.under_way(rig.scripted_driver())
        require_in_time(time_stop(rig, ROWS["fence-lost"], lambda: rig.mock.tell("reset@0-0.05").t_ns))
        wait_for(lambda: driver.gate.held == "fence-lost", 10.0, "the base to be connected again")
        reconnected_ns = time.monotonic_ns()
        time.sleep(1.0)  # the driver asks for the lease all the time
        assert not driver.driving
        assert rig.stood(reconnected_ns) == 0.0


@pytest.fixture(scope="module")
def gyro_rig(tmp_path_factory):
    with Rig(tmp_path_factory.mktemp("rig"), COURSE, mock=["--gyro"]) as rig:
        yield rig


def ended(rig, key, deploy):
    """End a driver and measure how soon the rover stands; return its result."""
    require_in_time(time_stop(rig, ROWS[key], lambda: deploy.send_signal(signal.SIGTERM)))
    return deploy.wait(15.0).result


@pytest.mark.parametrize("key", ["gyro-standing", "gyro-moving"])
def test_one_false_reading_of_a_gyro_turns_no_estimate(gyro_rig, key):
    rig, headings = gyro_rig, []

    def receive(sample):
        headings.append((read_pose(sample.payload.to_bytes()).pose.theta, rig.truth.read()[-1].pose.theta))

    start = rig.truth.read()[-1].pose.theta
    subscriber = rig.watcher.session.declare_subscriber("rover/estimate", receive)
    deploy = rig.drive_course()
    if key == "gyro-standing":
        wait_for(lambda: rig.watcher.gate.lease, READY_TIMEOUT_S, "the lease")
    else:
        rig.driven(deploy)
    rig.mock.tell("gyro=2@0-0.1")
    rig.driven(deploy)
    time.sleep(GOES_ON_S)
    result = ended(rig, key, deploy)
    subscriber.undeclare()
    assert result["stopped_by"] is None
    assert result["gyro"]["rejected"] >= 1
    # A driver that believed it would be 0.2 rad off. The rover turns by up to 0.02 rad between two estimates.
    assert abs(wrap_angle(headings[-1][0] - (headings[-1][1] - start))) < 0.06


class Localiser(Peer):
    """Publishes the true pose from where the rover stood; its clock is ``behind_s`` behind."""

    def __init__(self, rig):
        super().__init__(client_config(rig.robot, None)[0])
        self._truth, self._start, self.behind_s = rig.truth, rig.truth.read()[-1].pose, 0.0

    def run(self):
        covariance = np.diag(np.square([0.005, 0.005, 0.01]))
        while not self.closing.wait(0.1):
            state = self._truth.read()[-1]
            stamp_ns = state.wall_ns - round(self.behind_s * 1e9)
            pose = relative(self._start, state.pose)
            self.session.put(key("", "pose"), pose_with_covariance(pose, covariance, stamp_ns, COURSE_FRAME))


@pytest.mark.parametrize("step_s", CLOCK_STEPS_S.values())
def test_a_clock_of_a_localiser_that_steps_back_costs_no_drive_and_few_poses(rig, step_s):
    with Localiser(rig) as localiser:
        deploy = rig.drive_course("--pose", "required")
        rig.driven(deploy)
        localiser.behind_s = step_s
        time.sleep(2.0 * GOES_ON_S)
        assert abs(speed(rig.truth)) > CREEP_M_S
        result = ended(rig, f"localiser-clock-{step_s:g}", deploy)
    assert result["stopped_by"] is None
    poses = result["pose"]
    assert poses["used"] > 20
    assert poses["refused"] == 0
    assert poses["doubtful"] + poses["too_late"] <= 1  # the step costs one pose
