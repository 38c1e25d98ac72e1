"""A ROS 2 base on a virtual clock and sessions with a Pioneer, for several files."""

import pytest
from kit.arcos_bench import Bench
from kit.ros2_world import World

from bridge.base import Ready
from bridge.pioneer.states import SessionState


@pytest.fixture
def world():
    return World()


@pytest.fixture
def ready(world):
    world.run(2.0)
    assert [type(event) for event in world.events] == [Ready]
    return world


@pytest.fixture
def bench():
    """A session with a ready base."""
    return Bench().go_to(SessionState.READY)


@pytest.fixture
def opened():
    """A session with a base that has sent neither its configuration nor a report."""
    return Bench().go_to(SessionState.CONFIGURING)
