"""A ROS 2 base on a virtual clock, for several files."""

import pytest
from kit.ros2_world import World

from bridge.base import Ready


@pytest.fixture
def world():
    return World()


@pytest.fixture
def ready(world):
    world.run(2.0)
    assert [type(event) for event in world.events] == [Ready]
    return world
