"""ROS nodes beside a Pioneer: what they see, and how they drive it by teleop --topic."""

import json
from contextlib import contextmanager

import pytest
from kit.bridge_bench import Driver, wait_for
from ros.rig import RunWithRos, free_address

from rover_ncp.wire.messages import TWIST, TWIST_STAMPED
from sim.park.live import Process

# teleop_twist_keyboard's first message of its key i: speed 0.5, turn 1.0, and no frame.
LINEAR = {"x": 0.5, "y": 0.0, "z": 0.0}
TELEOP = {
    TWIST: {"linear": LINEAR, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}},
    TWIST_STAMPED: {"header": {"frame_id": ""}, "twist": {"linear": LINEAR}},
}


class Pioneer(RunWithRos):
    """A mock Pioneer, a bridge in both forms of ROS, and a relay between the bridge and DDS."""

    def start(self):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("ROS_DOMAIN_ID", str(self.domain))
            super().start()
        self.start_relay(free_address(), "-e", self.robot)

    @contextmanager
    def topic(self, *command, by="rclpy"):
        """A node that publishes or listens until the block ends."""
        router = ["--by", by, "--router", self.robot.removeprefix("tcp/")]
        node = self.ros("topic", "topic.py", *router, *command)
        try:
            node.wait_for_line("{")
            yield node
        finally:
            node.stop()


@pytest.fixture(scope="module")
def pioneer(tmp_path_factory):
    options = ["--ros", "ros2dds", "--ros", "rmw-zenoh"]
    with Pioneer(tmp_path_factory.mktemp("pioneer"), bridge=options) as run:
        arguments = ["--robot", run.robot, "--topic", "cmd_vel"]
        run.start_process(lambda: Process("teleop", arguments, run.folder)).wait_for_line("passes on")
        yield run


def moved(odometry):
    return odometry["pose"]["pose"]["position"]["x"]


@pytest.mark.parametrize("way", ["rclpy", "pyzeros"])
@pytest.mark.parametrize("ros_type", [TWIST, TWIST_STAMPED], ids=["Twist", "TwistStamped"])
def test_the_keyboard_node_of_ros_drives_a_pioneer(ros_type, way, pioneer):
    with pioneer.topic("echo", "odom", "nav_msgs/msg/Odometry") as odometry:
        begin = moved(odometry.last)
        assert odometry.last["header"]["frame_id"] == "odom"
        with pioneer.topic("pub", "cmd_vel", ros_type, json.dumps(TELEOP[ros_type]), by=way):
            wait_for(lambda: moved(odometry.last) > begin + 0.1, 20.0)
        wait_for(lambda: odometry.last["twist"]["twist"]["linear"]["x"] == 0.0)
    with Driver(pioneer.robot) as driver:  # the node is gone: the gate is free again
        wait_for(lambda: driver.motors().granted)
        driver.motors(enable=False)
