"""A ROS node's drive on the virtual clock: when its commands count, and when they stop to."""

import math
from dataclasses import dataclass

import pytest
from kit.virtual_drive import VirtualDrive

from deploy.drive.link import RosCommand
from deploy.topic_teleop import TopicTeleop
from rover_ncp.core.geometry import STANDSTILL, Velocity
from rover_ncp.wire.messages import twist_stamped

PERIOD_S = 0.1
AHEAD = Velocity(0.1, 0.0)


@dataclass
class Span:
    """A publisher's commands in a part of the test, in s since it began."""

    begin: float
    end: float
    velocity: Velocity | None
    source: str = "a"
    age_s: float = 0.0
    data: bytes | None = None


class Run:
    """The topic's commands on a virtual clock; ``at`` has times and what is called then."""

    def __init__(self, *spans):
        self.virtual, self.spans, self.at = VirtualDrive(), spans, []
        self.link, self.bridge = self.virtual.link, self.virtual.bridge
        self.speeds, self.leases = {}, []

    def commands(self, begin, end):
        for span in self.spans:
            for k in range(math.ceil(begin / PERIOD_S), math.ceil(end / PERIOD_S)):
                if span.begin <= k * PERIOD_S < span.end:
                    stamp_ns = self.bridge.time_ns() - round(span.age_s * 1e9)
                    data = twist_stamped(span.velocity, stamp_ns) if span.data is None else span.data
                    yield RosCommand(data, self.bridge.monotonic(), span.source)

    def read(self, timeout_s):
        now = self.bridge.monotonic() - self.began_s
        while self.at and self.at[0][0] <= now:
            self.at.pop(0)[1]()
        self.speeds[now] = self.virtual.rover.velocity.v
        self.leases.append((now, self.link.gate.lease))
        self.bridge.sleep(timeout_s)
        return list(self.commands(now, self.bridge.monotonic() - self.began_s))

    def run(self, seconds):
        def interrupted():
            return self.bridge.monotonic() - self.began_s > seconds

        self.began_s = math.inf
        teleop = TopicTeleop(self.link, self.read, interrupted, self.bridge)
        teleop.wait()
        self.began_s = self.bridge.monotonic()
        with pytest.raises(KeyboardInterrupt):
            teleop.run()
        assert self.link.lease.number == 0
        assert self.virtual.stands()
        return self

    def moved(self, begin, end):
        """Whether the rover moved in a part of the test."""
        return any(abs(v) > 0.01 for at, v in self.speeds.items() if begin <= at <= end)


def test_a_node_drives_while_it_publishes_and_releases_the_lease_afterwards():
    run = Run(Span(2.0, 4.0, AHEAD)).run(5.5)
    assert run.speeds[max(at for at in run.speeds if at < 3.9)] == pytest.approx(0.1, abs=0.003)
    assert not run.moved(3.9 + 0.4 + 0.1 / 0.3 + 0.2, 5.5)
    released = next(at for at, lease in run.leases if at > 4.0 and lease == 0)
    assert released == pytest.approx(3.9 + 1.0, abs=0.15)


def test_a_node_that_never_pauses_moves_nothing_until_it_sends_zeros():
    spans = Span(0.0, 3.0, AHEAD), Span(3.0, 3.5, STANDSTILL), Span(3.5, 5.5, AHEAD)
    run = Run(*spans).run(6.5)
    assert not run.moved(0.0, 3.4)
    assert run.moved(4.0, 5.5)


def test_a_zero_of_another_node_behind_the_same_bridge_is_no_pause():
    """One bridge of ROS 2 publishes for all its nodes, so both have one source."""
    run = Run(Span(0.0, 4.0, AHEAD), Span(2.0, 2.1, STANDSTILL), Span(3.0, 3.2, STANDSTILL)).run(5.0)
    assert not run.moved(0.0, 5.0)


def test_after_a_stop_a_node_drives_only_after_a_pause():
    run = Run(Span(1.1, 4.0, AHEAD), Span(5.2, 6.5, AHEAD))
    run.at = [
        (2.5, lambda: run.bridge.query("rover/stop", b"{}")),
        (3.0, lambda: run.bridge.query("rover/stop", b'{"release": true}')),
    ]
    run.run(7.0)
    assert run.moved(1.5, 2.5)
    assert not run.moved(3.3, 5.2)
    assert run.moved(5.5, 6.5)


def test_only_one_node_drives_at_a_time(caplog):
    caplog.set_level("INFO", "rover_ncp")
    backward = Span(2.0, 4.0, Velocity(-0.3, 0.0), "b")
    run = Run(Span(1.5, 4.0, AHEAD), backward).run(5.0)
    assert min(run.speeds.values()) > -0.01
    assert run.moved(3.0, 4.0)
    assert caplog.text.count("another node publishes commands on the topic too") == 1


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"velocity": AHEAD, "age_s": 0.5}, "0.5 s old"),
        ({"velocity": Velocity(math.nan, 0.0)}, "not finite"),
        ({"velocity": None, "data": b"x" * 60}, "cannot be read"),
    ],
    ids=["stale", "not finite", "unreadable"],
)
def test_a_command_that_is_not_fresh_finite_and_readable_stops_the_rover(bad, words, caplog):
    caplog.set_level("INFO", "rover_ncp")
    run = Run(Span(1.5, 3.0, AHEAD), Span(3.0, 5.0, **bad)).run(5.0)
    assert run.moved(2.0, 3.0)
    assert not run.moved(3.9, 5.0)
    assert caplog.text.count(words) == 1
    assert next(at for at, lease in run.leases if at > 3.0 and lease == 0) < 4.2


def test_another_driver_follows_and_is_not_disturbed():
    run = Run(Span(1.5, 2.5, AHEAD), Span(4.0, 6.0, STANDSTILL))
    request = b'{"enable": true, "name": "other"}'
    run.at = [(3.9, lambda: run.bridge.query("rover/motors", request))]
    run.run(4.7)
    assert {lease for at, lease in run.leases if at > 4.0} == {2}
