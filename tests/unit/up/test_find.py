"""Robots among the topics that a router announces."""

import pytest

from bridge.ros2.address import command_type, hazard_topics, sensor_topics
from bridge.ros2.discovery import Announced
from bridge.setup.find import robots_among
from rover_ncp.core.files import shipped_names
from rover_ncp.robot.description import load_description

DESCRIPTIONS = {name: load_description(name) for name in shipped_names("robots")}
ROS2 = [name for name, found in DESCRIPTIONS.items() if found.topics is not None]


def topics_of(model, prefix=""):
    topics = DESCRIPTIONS[model].topics
    named = [*sensor_topics(topics), *((each.topic, kind) for each, kind in hazard_topics(topics))]
    found = [Announced("z", True, f"{prefix}{name}", kind, "node") for name, kind in named]
    return [*found, Announced("z", False, f"{prefix}{topics.cmd_vel}", command_type(topics), "node")]


@pytest.mark.parametrize("model", ROS2)
def test_a_shipped_robot_is_recognised_by_its_topics(model):
    (robot,) = robots_among("tcp/10.0.0.5:7447", "", topics_of(model))
    assert robot.address == "ros2/tcp/10.0.0.5:7447"
    # A Husky and a Jackal have the same topics.
    assert DESCRIPTIONS[robot.model].topics == DESCRIPTIONS[model].topics


def test_two_robots_of_one_router_are_told_apart_by_their_namespaces():
    camera = Announced("z", True, "bot2/oakd/image", "sensor_msgs/msg/CompressedImage", "node")
    announced = [*topics_of("turtlebot4", "bot1/"), *topics_of("turtlebot4", "bot2/"), camera]
    first, second = robots_among("tcp/r:7447", "rmw=zenoh&domain=7", announced)
    assert first.address == "ros2/tcp/r:7447#rmw=zenoh&domain=7&namespace=bot1"
    assert (second.model, second.images) == ("turtlebot4", ("oakd/image",))
