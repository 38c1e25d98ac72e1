"""What the driver does with odometry, gyro readings and external poses whose stamps are wrong."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from kit.virtual_drive import ChangedLink

from deploy.drive.link import Arrival, Inbox
from deploy.drive.measurements import Measurements
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.geometry import ORIGIN, Velocity
from rover_ncp.robot.description import load_description
from rover_ncp.robot.lasting_error import LastingError
from rover_ncp.wire.messages import imu, odometry, pose_with_covariance, text
from sim.base.firmware import Firmware
from sim.stack.virtual import VirtualBridge
from sim.world.described import default_rover
from sim.world.pymunk_rover import Ground, PymunkRover

WALL_NS = 1_700_000_000 * NS_PER_S
MS = NS_PER_S // 1000
PERIOD = 100 * MS
TRANSIT = 20 * MS
MESSAGES = {
    "odom": lambda stamp: odometry(ORIGIN, Velocity(0.0, 0.0), stamp),
    "imu": lambda stamp: imu(0.0, 1e-6, stamp),
    "pose": lambda stamp: pose_with_covariance(ORIGIN, np.eye(3), stamp, "course"),
}


@pytest.fixture
def log(caplog):
    caplog.set_level("INFO", "rover_ncp")
    return caplog


class Driver:
    """The measurements of a link whose messages the test brings."""

    def __init__(self):
        self.inboxes = {"odom": Inbox(1), "imu": Inbox(), "pose": Inbox()}
        odometry, gyro, poses = self.inboxes.values()
        self.measurements = Measurements(
            SimpleNamespace(odometry=odometry, gyro=gyro, poses=poses, complaints={})
        )

    def take(self, topic, stamp_ns, arrival_ns):
        """Return what a message makes available."""
        self.inboxes[topic].put(Arrival(MESSAGES[topic](stamp_ns), arrival_ns))
        if topic == "odom":
            newest = self.measurements.odometry(0)
            return [] if newest is None else [newest]
        return self.measurements.gyro() if topic == "imu" else self.measurements.poses()

    def ages_ms(self, topic, stamp_ns, arrival_ns):
        found = self.take(topic, stamp_ns, arrival_ns)
        return [round((arrival_ns - taken.ref.measured_ns) / MS) for taken in found]


@pytest.mark.parametrize("topic", MESSAGES)
@pytest.mark.parametrize("step_s", [-3600.0, 0.6])
def test_a_publishers_clock_that_is_set_costs_one_sample(topic, step_s, log):
    driver = Driver()
    for number in range(40):
        stamp = WALL_NS + number * PERIOD + (round(step_s * NS_PER_S) if number >= 20 else 0)
        ages = driver.ages_ms(topic, stamp, number * PERIOD + TRANSIT)
        assert ages == ([] if number == 20 else [0])
    back = [f"the clock that stamps '{topic}' was set back by {-step_s:.2f} s"] if step_s < 0 else []
    assert log.messages == back
    assert driver.measurements.doubtful == {topic: 1}


def test_poses_out_of_order_are_used_for_their_moment():
    driver = Driver()
    moments = [(stamp, arrival) for stamp, arrival in ((0, 0), (10, 10), (4, 11), (12, 12))]
    ages = [driver.ages_ms("pose", WALL_NS + stamp * PERIOD, arrival * PERIOD) for stamp, arrival in moments]
    assert ages == [[0], [0], [], [800, 0]]  # the late one is known as such by the next
    assert driver.measurements.doubtful == {"pose": 0}


@pytest.mark.parametrize("age_ms", [0, 50, 150])
def test_the_age_of_a_gyro_reading_counts_beside_odometry_though_all_have_it(age_ms):
    driver = Driver()
    for number in range(20):
        stamp, arrival = WALL_NS + number * PERIOD, number * PERIOD + TRANSIT
        [sample] = driver.take("odom", stamp, arrival)
        [reading] = driver.take("imu", stamp - age_ms * MS, arrival)
        assert (sample.ref.measured_ns - reading.ref.measured_ns) / MS == pytest.approx(age_ms, abs=0.001)


@pytest.mark.parametrize("topic", MESSAGES)
def test_samples_without_a_stamp_are_as_young_as_their_arrival(topic):
    driver = Driver()
    assert [driver.ages_ms(topic, 0, number * PERIOD) for number in range(20)] == [[0]] * 20


def test_message_that_cannot_be_read_is_left_out_and_named(log):
    driver = Driver()
    driver.inboxes["pose"].put(Arrival(MESSAGES["pose"](WALL_NS)[:-9], 0))
    assert driver.measurements.poses() == []
    assert "a message on 'pose' is not used: " in log.text


TAGS = {"kind": "tags", "frame": "board-17-a4"}


@pytest.mark.parametrize(
    ("declared", "described_m", "expected_m"),
    [
        ([TAGS, {"kind": "motion-capture", "frame": "/course"}], None, 0.002),
        ([TAGS, {"kind": "motion-capture", "frame": "/course"}], 0.03, 0.03),  # the description counts first
        ([{"kind": "motion-capture", "frame": "course"}, TAGS], None, 0.002),
        ([TAGS], None, 0.08),  # no source declares the errors of the poses that are used
        ([TAGS], 0.03, 0.03),
        ([TAGS, {"kind": "motion-capture"}], None, 0.002),
        (
            [{"frame": str(number)} for number in range(100)] + [{"kind": "tags", "frame": "course"}],
            None,
            0.08,
        ),
    ],
)
def test_lasting_errors_are_those_that_the_source_of_the_poses_declares(declared, described_m, expected_m):
    link = ChangedLink(
        VirtualBridge(Firmware("p3at-sh", PymunkRover(default_rover(), Ground()))), lambda message: None
    )
    link._lasting = {}
    for each in declared:
        link.put("rover/localiser", text(json.dumps(each)))
    error = described_m and LastingError(position_m=described_m, heading_rad=0.03, time_s=5.0)
    robot = load_description("turtlebot4").model_copy(update={"lasting_error": error})
    assert link.lasting_error("course", robot).values.position_m == expected_m
