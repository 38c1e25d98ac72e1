"""The key of a lease goes to its driver and nowhere else, on a virtual clock."""

import json

from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.wire.protocol import MotorsReply, parse_json
from sim.pioneer.firmware import Firmware
from sim.stack.virtual import VirtualBridge, VirtualLink
from sim.world.described import default_rover
from sim.world.pymunk_rover import Ground, PymunkRover


class OpenWorld(VirtualBridge):
    """A world that keeps all that the bridge publishes and all that it answers."""

    def __init__(self):
        super().__init__(Firmware("p3at-sh", PymunkRover(default_rover(), Ground(()))))
        self.published, self.answered = [], []

    def publish(self, name, data):
        self.published.append(data)
        super().publish(name, data)

    def query(self, name, payload, attachment=None):
        answer = super().query(name, payload, attachment)
        self.answered.append(parse_json(MotorsReply, answer))
        return answer

    def command(self, data, attachment):
        self.published += [data, attachment]
        super().command(data, attachment)


def test_the_key_is_in_the_first_answer_and_in_no_message_recording_or_state():
    world, recorded = OpenWorld(), []
    driver = VirtualLink(world, Pose(0.0, 0.0, 0.0), recorded.append)
    world.sleep(3.0)
    driver.request_motors("test")
    for _ in range(20):
        driver.command(Velocity(0.1, 0.0))
        world.sleep(0.1)
    driver.request_motors("test")
    driver.release()
    world.sleep(0.5)

    grant, renewal, release = world.answered
    key = bytes.fromhex(grant.key)
    assert len(key) == 32
    assert (renewal.granted, renewal.lease, renewal.key) == (True, grant.lease, "")
    assert not release.granted
    messages = b"".join([*world.published, *(message.data for message in recorded)])
    assert len(world.published) > 100
    assert len(recorded) > 100
    assert key not in messages
    assert grant.key.encode() not in messages
    assert grant.key not in f"{grant} {renewal!r} {driver.gate!r}"
    assert json.loads(driver.gate.model_dump_json())["lease"] == 0


def test_two_leases_have_two_keys():
    world = OpenWorld()
    driver = VirtualLink(world, Pose(0.0, 0.0, 0.0))
    world.sleep(3.0)
    for _ in range(2):
        driver.request_motors("test")
        driver.release()
    grants = [reply for reply in world.answered if reply.granted]
    assert len({reply.key for reply in grants}) == 2
    assert [reply.lease for reply in grants] == [1, 2]
