"""The real session with the mock base, through memory, on a virtual clock, over lines good and bad."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from kit.pioneer_bench import Pioneer

from bridge.base import BaseReport, Failed, Lost, Ready, Recovered
from bridge.pioneer.framing import HOSTBAUD_RATES
from bridge.pioneer.odometry import ROBOTS
from bridge.pioneer.session import BaudChanged, Session, SessionEvent
from bridge.pioneer.states import FAST_RATE, SessionState
from rover_ncp.core.geometry import Velocity
from sim.base.models import config_of

STEP_S = 0.02


class Pair:
    """A session and a base, 50 turns a second; ``command`` is what a gate sends in each.

    A line that the session gives up is replaced at once, as the bridge does. One with a ``rate`` is serial.
    """

    def __init__(self, pioneer: Pioneer | None = None, rate: int | None = None) -> None:
        self.pioneer = pioneer or Pioneer()
        self.opened_rate = rate
        self.session = Session()
        self.events: list[SessionEvent] = []
        self.command: Velocity | None = None
        self.cut_up = self.cut_down = False
        self.connect()

    def connect(self) -> None:
        self.rate = self.opened_rate
        self.session.connect(self.now, self.rate)

    @property
    def now(self) -> float:
        return self.pioneer.now

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        firmware = self.pioneer.firmware
        for _ in range(round(seconds / STEP_S)):
            self.pioneer.now += STEP_S
            firmware.advance(self.now)
            events = self.session.receive(self.arriving(firmware.data_to_send(), self.cut_up), self.now)
            if self.command is not None:
                self.session.set_motion(self.command)
            events += self.session.tick(self.now)
            for event in events:
                if isinstance(event, BaudChanged):
                    self.rate = event.baudrate
                elif isinstance(event, Failed) and self.of(Ready):
                    self.connect()
            self.events += events
            firmware.receive(self.arriving(self.session.data_to_send(), self.cut_down), self.now)
            if until():
                return

    def arriving(self, data: bytes, cut: bool) -> bytes:
        """Return what arrives of bytes: others if the two ends have different rates."""
        garbled = self.rate not in {None, self.pioneer.firmware.baudrate}
        return b"" if cut else bytes(byte ^ 0x80 for byte in data) if garbled else data

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


@pytest.mark.parametrize("model", list(ROBOTS))
def test_rover_is_ready_within_a_second_follows_setpoints_and_reports_its_motion(model: str) -> None:
    pair = Pair(Pioneer(model)).ready()
    assert pair.now < 1.0
    pair.run(0.3)
    assert [type(event) for event in pair.events[:2]] == [Ready, BaseReport]
    assert pair.events[0].robot.name == model
    assert not pair.state.motors_on
    pair.driving(0.16, 0.137).run(10.0)
    assert pair.state.v == pytest.approx(0.16, abs=0.001)
    pair.command = Velocity(0.0, 0.0)
    pair.run(3.0)
    true, state = pair.pioneer.rover.pose, pair.state
    assert (state.x, state.y) == pytest.approx((true.x, true.y), abs=0.003)
    assert math.remainder(state.theta - true.theta, math.tau) == pytest.approx(0, abs=0.002)
    assert state.v == state.omega == 0.0
    # The delays and ramps of starting and stopping cancel out; enabling took a SIP or two.
    assert state.theta == pytest.approx(0.137 * 10, abs=0.03)


BRAKING_S = 0.15 + 0.2 / 0.31
"""The base's delay, and braking from 0.2 m/s at 0.31 m/s²."""


def test_a_cut_line_leaves_the_rover_to_the_bases_watchdog_and_it_stays_put_afterwards(driving: Pair) -> None:
    driving.cut_up = driving.cut_down = True
    cut = driving.now
    driving.run(5.0, until=lambda: driving.pioneer.rover.velocity.v == 0.0)
    assert 2.0 < driving.now - cut < 2.0 + 0.25 + BRAKING_S + 0.1
    x = driving.pioneer.rover.pose.x
    driving.run(0.2)
    driving.cut_up = driving.cut_down = False
    driving.run(5.0)
    assert driving.session.state is SessionState.READY
    assert driving.of(Recovered) or len(driving.of(Ready)) == 2
    assert driving.pioneer.rover.pose.x - x < 0.002
    assert not driving.state.motors_on


@pytest.mark.parametrize("flash", [9600, FAST_RATE])
def test_serial_line_runs_at_the_fast_rate_until_it_is_closed_also_after_a_killed_bridge(flash: int) -> None:
    config = replace(config_of(ROBOTS["p3at-sh"]), host_baud=HOSTBAUD_RATES.index(flash))
    pioneer = Pioneer(config=config)
    for _ in range(2):
        pair = Pair(pioneer, rate=9600).ready()
        pair.run(1.0)
        assert pair.state.battery_v > 0
        assert pair.rate == pioneer.firmware.baudrate == FAST_RATE
    pair.session.close(pair.now)
    pair.run(0.1)
    assert pioneer.firmware.baudrate == flash


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
