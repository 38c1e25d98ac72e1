"""The bridge's stamps when the wall clock is set, on a virtual clock."""

import pytest

from rover_ncp.core.errors import FormatError
from rover_ncp.core.messages import read_odometry
from rover_ncp.core.protocol import MotorsReply, MotorsRequest, dump_json, parse_json
from sim.pioneer.firmware import Firmware
from sim.stack.virtual import WALL_NS, World
from sim.world.pymunk_rover import Ground, PymunkRover
from sim.world.rover import RoverModel

HOUR_NS = 3600 * 1_000_000_000
SECOND_NS = 1_000_000_000


class SetWorld(World):
    """A world whose wall clock can be set."""

    set_ns = 0

    def time_ns(self):
        return super().time_ns() + self.set_ns


@pytest.fixture
def world():
    world = SetWorld(Firmware("p3at-sh", PymunkRover(RoverModel(), Ground(()))))
    world.stamps = []

    def hear(name, data):
        if name == "odom":
            try:
                world.stamps.append(read_odometry(data).stamp_ns - WALL_NS - world.now_ns)
            except FormatError as error:
                raise AssertionError from error

    world.hear = hear
    world.sleep(3.0)
    assert abs(world.stamps[-1]) < SECOND_NS / 10
    return world


def motors(world):
    request = MotorsRequest(enable=True, name="x", sent_ns=world.now_ns)
    return parse_json(MotorsReply, world.ask("rover/motors", dump_json(request)))


@pytest.mark.parametrize("step_ns", [HOUR_NS, -HOUR_NS])
def test_stamps_do_not_step_during_a_lease_and_are_right_again_after_it(world, step_ns):
    assert motors(world).granted
    world.set_ns = step_ns
    del world.stamps[:]
    world.sleep(0.8)
    assert len(world.stamps) >= 7
    assert all(abs(stamp) < SECOND_NS / 10 for stamp in world.stamps)
    world.sleep(1.8)  # the lease lapses: no command comes
    assert abs(world.stamps[-1] - step_ns) < SECOND_NS / 10
