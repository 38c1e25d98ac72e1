"""The bridge's loop and its base: exceptions of a base, its end, its reconnection, its motors."""

import logging
from importlib.metadata import EntryPoint

import pytest
from kit.driver_client import DriverClient

from bridge.base import BaseReport, BaseTimeout, Failed, LinkHealth, Lost, Ready, Recovered, Setpoint
from bridge.bases import choose_base, open_base
from bridge.gate.limits import Fence, Limits
from bridge.inbox import CommandMessage, Inbox, Query
from bridge.node import Node
from rover_ncp.core.errors import NoRobot, SafetyStop, UsageError
from rover_ncp.core.geometry import Velocity
from rover_ncp.robot.description import load_description
from rover_ncp.wire.protocol import TimeoutState

STOP = Setpoint(Velocity(0.0, 0.0), motors=False, emergency=False)
READY = Ready("x", load_description("p3at"))
FENCED = Limits(fence=Fence(x_min=-1.0, x_max=1.0, y_min=-1.0, y_max=1.0))


class FailingBase:
    """A base of another package that reports at each arrival; `fails` is what raises, and with what."""

    def __init__(self):
        self.fails, self.driven, self.calls = {}, [], []
        self.timeout = BaseTimeout(TimeoutState.PUBLISHED, 1.0)
        self.reports = [READY]

    def _call(self, name, result=None):
        self.calls.append(name)
        if name in self.fails:
            raise self.fails[name]
        return result

    def receive(self, arrival, now):
        events, self.reports = self._call("receive", [*self.reports, BaseReport()]), []
        return events

    def drive(self, setpoint, now):
        self.driven += self._call("drive", [setpoint])
        return []

    def health(self):
        return self._call("health", LinkHealth(damaged=False, counters={}))

    @property
    def base_timeout(self):
        return self._call("base_timeout", self.timeout)

    def close(self, now):
        self._call("close")


class Loop:
    """A node with such a base, on a virtual clock: each turn takes 20 ms and brings a report."""

    def __init__(self, limits=None, turns=0):
        self.now_ns, self.base, self.driver = 10**9, FailingBase(), DriverClient(self)
        self.arrivals, self.silent = [], False
        self.node = Node(
            self.base,
            self.take,
            key=self.key,
            publish=self.publish,
            limits=limits or Limits(),
            ready=lambda: None,
            clock=self,
            suspended_s=lambda: 0.0,
        )
        self.turn(turns)

    def monotonic(self):
        return self.now_ns * 1e-9

    def monotonic_ns(self):
        return self.now_ns

    time_ns = monotonic_ns

    def take(self, timeout_s):
        arrived, self.arrivals = [*self.arrivals, *([] if self.silent else [b"report"])], []
        return [(self.monotonic(), arrival) for arrival in arrived]

    def key(self, name):
        return name

    def publish(self, name, data):
        pass

    def turn(self, times=1):
        for _ in range(times):
            self.now_ns += 20_000_000
            self.node.run_once()

    def query(self, name, payload, tag=None, source=""):
        replies = []
        self.arrivals.append(Query(name, payload, tag, replies.append, replies.append, source))
        self.turn()
        return replies[0]

    def command(self, data, tag):
        self.arrivals.append(CommandMessage(data, tag))

    def sleep(self, seconds):
        self.turn()

    def drive(self):
        self.driver.drive(1.0, 0.2)
        return self.base.driven[-1]


@pytest.fixture
def driving(caplog):
    caplog.set_level(logging.INFO, "rover_ncp")
    loop = Loop(turns=3)
    assert loop.driver.motors().granted
    assert loop.drive().velocity == (0.2, 0.0)
    return loop


@pytest.mark.parametrize("fails", ["", "drive", "close"])
def test_end_of_the_loop_drives_zero_with_motors_off_and_closes_whatever_fails(driving, fails, caplog):
    driving.base.fails[fails] = BrokenPipeError(32, "Broken pipe")
    driving.node.run(lambda: True)
    assert driving.base.calls[-2:] == ["drive", "close"]
    assert driving.base.driven[-1] == STOP or fails == "drive"
    assert not fails or caplog.messages[-1] == "the base failed: [Errno 32] Broken pipe"


def test_error_of_the_loop_stops_the_base_too(driving):
    def stopping():
        raise RuntimeError("a bug")

    with pytest.raises(RuntimeError, match="a bug"):
        driving.node.run(stopping)
    assert driving.base.driven[-1] == STOP


@pytest.mark.parametrize("fenced", [False, True])
@pytest.mark.parametrize("fails", ["receive", "drive", "health", "base_timeout"])
def test_exception_of_the_base_stops_the_rover_and_ends_the_bridge(fenced, fails):
    loop = Loop(limits=FENCED if fenced else Limits(), turns=3)
    assert loop.driver.motors().granted
    assert loop.drive().velocity == (0.2, 0.0)
    loop.base.fails[fails] = ValueError("x")
    with pytest.raises(SafetyStop if fenced else NoRobot, match="the base failed: ") as stop:
        loop.node.run(lambda: loop.query("rover/base", b"{}") == b"")
    assert stop.value.exit_code == (4 if fenced else 3)
    assert loop.base.driven[-1] == STOP or fails == "drive"
    assert loop.base.calls[-1] == "close"


def test_base_of_another_package_is_opened_by_its_entry_point(monkeypatch):
    opened = []
    monkeypatch.setitem(globals(), "opens", lambda *what: opened.append(what) or FailingBase())
    known = {"mine": f"{__name__}:opens", "bad": f"{__name__}:no"}
    monkeypatch.setattr(
        "bridge.bases.entry_points", lambda group, name: [EntryPoint(name, known[name], group)]
    )
    rest = {"no_base_watchdog": False}
    base, _ = open_base(choose_base("mine/10.0.0.1:9", "turtlebot4"), Limits(), Inbox(), None, **rest)
    assert isinstance(base, FailingBase)
    assert opened[0][:2] == ("10.0.0.1:9", load_description("turtlebot4"))
    with pytest.raises(UsageError, match="cannot be loaded"):
        open_base(choose_base("bad/x", "turtlebot4"), Limits(), Inbox(), None, **rest)
    with pytest.raises(UsageError, match="only a Pioneer says what it is"):
        choose_base("mine/x", "auto")


def test_base_that_fails_before_it_was_ready_ends_the_bridge_in_one_line():
    loop = Loop()
    loop.base.reports = [Failed("it is no ARCOS base")]
    with pytest.raises(NoRobot, match="it is no ARCOS base"):
        loop.node.run(lambda: loop.turn() or False)
    assert loop.base.driven == [STOP]
    assert loop.base.calls[-1] == "close"


@pytest.mark.parametrize("fenced", [True, False])
@pytest.mark.parametrize("again", ["ready", "recovered"])
def test_base_that_is_ready_again_has_other_odometry_and_one_that_recovers_the_same(fenced, again):
    loop = Loop(limits=FENCED if fenced else Limits(), turns=3)
    loop.base.reports = [Lost("x"), READY if again == "ready" else Recovered()]
    loop.turn(2)
    reply = loop.driver.motors()
    assert reply.granted is (not fenced or again == "recovered")
    assert reply.granted or reply.reason == "fence-lost"


def test_the_log_names_who_takes_a_drive_over(caplog):
    """Where no certificates are in use, three messages of any peer do."""
    loop = Loop(turns=3)
    assert loop.driver.motors().granted
    with caplog.at_level("INFO", "rover_ncp"):
        loop.query("rover/stop", b'{"reason": "mine"}', source="f00d")
        loop.query("rover/stop", b'{"release": true}')
        loop.query("rover/motors", b'{"enable": true, "name": "x"}', source="f00d")
    assert "the peer with the Zenoh id f00d requests a stop: mine" in caplog.text
    assert "a peer that states no Zenoh id requests the release of the stop" in caplog.text
    assert "the lease is that of the peer with the Zenoh id f00d" in caplog.text
