"""The real session with the mock base, through memory, on a virtual clock, over lines good and bad."""

import math
from collections.abc import Callable

import pytest
from kit.pioneer_bench import Pioneer

from bridge.base import BaseReport, Failed, Lost, Ready, Recovered
from bridge.pioneer.session import Session, SessionEvent
from bridge.pioneer.states import SessionState
from rover_ncp.core.geometry import Velocity

STEP_S = 0.02


class Pair:
    """A session and a base, 50 turns a second; ``command`` is what a gate sends in each.

    A line that the session gives up is replaced at once, as the bridge does.
    """

    def __init__(self, pioneer: Pioneer | None = None) -> None:
        self.pioneer = pioneer or Pioneer()
        self.session = Session()
        self.events: list[SessionEvent] = []
        self.command: Velocity | None = None
        self.cut = False
        self.session.connect(self.now)

    @property
    def now(self) -> float:
        return self.pioneer.now

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        firmware = self.pioneer.firmware
        for _ in range(round(seconds / STEP_S)):
            self.pioneer.now += STEP_S
            firmware.advance(self.now)
            sent = firmware.data_to_send()
            events = self.session.receive(b"" if self.cut else sent, self.now)
            if self.command is not None:
                self.session.set_motion(self.command)
            events += self.session.tick(self.now)
            for event in events:
                if isinstance(event, Failed) and self.of(Ready):
                    self.session.connect(self.now)
            self.events += events
            sent = self.session.data_to_send()
            firmware.receive(b"" if self.cut else sent, self.now)
            if until():
                return

    def ready(self) -> "Pair":
        self.run(20.0, until=lambda: self.session.state is SessionState.READY)
        assert self.session.state is SessionState.READY
        return self

    def driving(self, v: float, omega: float) -> "Pair":
        self.ready().session.enable(True)
        self.command = Velocity(v, omega)
        return self

    def of(self, kind: type) -> list:
        return [event for event in self.events if isinstance(event, kind)]

    @property
    def state(self) -> BaseReport:
        return self.of(BaseReport)[-1]


@pytest.fixture
def driving() -> Pair:
    """A pair that has driven at 0.2 m/s for 3 s."""
    pair = Pair().driving(0.2, 0.0)
    pair.run(3.0)
    return pair


BRAKING_S = 0.15 + 0.2 / 0.31
"""The base's delay, and braking from 0.2 m/s at 0.31 m/s²."""


def test_a_cut_line_leaves_the_rover_to_the_bases_watchdog_and_it_stays_put_afterwards(driving: Pair) -> None:
    driving.cut = True
    cut = driving.now
    driving.run(5.0, until=lambda: driving.pioneer.rover.velocity.v == 0.0)
    assert 2.0 < driving.now - cut < 2.0 + 0.25 + BRAKING_S + 0.1
    x = driving.pioneer.rover.pose.x
    driving.run(0.2)
    driving.cut = False
    driving.run(5.0)
    assert driving.session.state is SessionState.READY
    assert driving.of(Recovered) or len(driving.of(Ready)) == 2
    assert driving.pioneer.rover.pose.x - x < 0.002
    assert not driving.state.motors_on


@pytest.mark.parametrize("fault", ["corrupt=0.15", "drop=0.15", "noise=0.2"])
def test_a_bad_line_is_survived_both_ways(fault: str) -> None:
    """Invariant: the pose stays the base's, speeds stay as commanded, and the end is a standstill."""
    pair = Pair(Pioneer("p3at-sh", fault, seed=1)).driving(0.15, 0.1)
    pair.run(5.0, until=lambda: bool(pair.of(BaseReport)))
    for _ in range(100):
        pair.run(0.1)
        if pair.of(Lost):
            break
        assert abs(pair.pioneer.rover.target.v) < 0.1501
        odometry, state = pair.pioneer.firmware.drive.odometry, pair.state
        assert math.hypot(state.x - odometry.x, state.y - odometry.y) < 0.15 * 0.6 + 0.003
    decoder = pair.session.decoder
    assert decoder.bad_checksums + decoder.skipped_bytes > 0
    for _ in range(6):
        pair.session.close(pair.now)
        pair.run(0.1)
        pair.session.connect(pair.now)
        pair.run(2.0)
    assert pair.pioneer.rover.velocity == pytest.approx((0.0, 0.0))
