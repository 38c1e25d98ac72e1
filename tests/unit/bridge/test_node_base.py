"""The bridge's loop and its base: exceptions of a base, its end, its reconnection, its motors."""

import functools
from importlib.metadata import EntryPoint

import pytest
from kit.virtual_bench import VirtualDriver, VirtualRig

from bridge.base import Failed, Lost, Ready, Recovered, Setpoint
from bridge.bases import choose_base, open_base
from bridge.gate.limits import Fence, Limits
from bridge.inbox import Inbox, Query
from bridge.pioneer.base import ArcosBase
from rover_ncp.core.bridge_lines import BACK, HAZARD, LOST, STOPPED
from rover_ncp.core.errors import NoRobot, SafetyStop, UsageError
from rover_ncp.core.geometry import Velocity
from rover_ncp.robot.description import load_description
from sim.base.faults import Faults, parse_fault

ROBOT = load_description("p3at")
STOP = Setpoint(Velocity(0.0, 0.0), motors=False, emergency=False)
FENCED = Limits(fence=Fence(x_min=-1.0, x_max=1.0, y_min=-1.0, y_max=1.0))


class Watched(VirtualRig):
    """A bridge whose calls of its base are kept; those in ``fails`` raise."""

    def __init__(self, limits=None):
        super().__init__(ROBOT, limits=limits)
        self.fails, self.calls, self.driven, base = {}, [], [], self.connection.base
        for name in ("receive", "drive", "health", "close"):
            setattr(base, name, functools.partial(self.call, name, getattr(base, name)))

    def call(self, name, own, *arguments):
        self.calls.append(name)
        if name in self.fails:
            raise self.fails[name]
        if name == "drive":
            self.driven.append(arguments[0])
        return own(*arguments)

    def serve(self):
        """Let the bridge's loop run until it ends by itself."""

        def turn():
            self.now_ns += 20_000_000
            self.connection.advance(self.monotonic())
            return self.query("rover/base", b"{}") == b""

        self._node.run(turn)


def driven(limits=None):
    """Return a bridge whose rover is driven."""
    rig = Watched(limits)
    VirtualDriver(rig).start(0.2)
    assert rig.driven[-1].velocity == (0.2, 0.0)
    return rig


@pytest.mark.parametrize("fails", ["", "drive", "close"])
def test_end_of_the_loop_drives_zero_with_motors_off_and_closes_whatever_fails(fails, caplog):
    caplog.set_level("INFO", "rover_ncp")
    rig = driven()
    rig.fails[fails] = BrokenPipeError(32, "Broken pipe")
    rig._node.run(lambda: True)
    assert rig.calls[-2:] == ["drive", "close"]
    assert rig.driven[-1] == STOP or fails == "drive"
    assert not fails or caplog.messages[-1] == "the base failed: [Errno 32] Broken pipe"


def test_error_of_the_loop_stops_the_base_too():
    rig = driven()
    with pytest.raises(ZeroDivisionError):
        rig._node.run(lambda: 1 / 0)
    assert rig.driven[-1] == STOP


@pytest.mark.parametrize("fenced", [False, True])
@pytest.mark.parametrize("fails", ["receive", "drive", "health", "base_timeout"])
def test_exception_of_the_base_stops_the_rover_and_ends_the_bridge(fenced, fails, monkeypatch):
    rig = driven(FENCED if fenced else None)
    rig.fails[fails] = ValueError("x")
    if fails == "base_timeout":
        monkeypatch.setattr(ArcosBase, fails, property(lambda base: rig.call(fails, None)))
    with pytest.raises(SafetyStop if fenced else NoRobot, match="the base failed: ") as stop:
        rig.serve()
    assert stop.value.exit_code == (4 if fenced else 3)
    assert rig.driven[-1] == STOP or fails == "drive"
    assert "close" in rig.calls


def test_base_of_another_package_is_opened_by_its_entry_point(monkeypatch):
    opened = []
    monkeypatch.setitem(globals(), "opens", lambda *what: opened.append(what) or "its base")
    known = {"mine": f"{__name__}:opens", "bad": f"{__name__}:no"}
    monkeypatch.setattr(
        "bridge.bases.entry_points", lambda group, name: [EntryPoint(name, known[name], group)]
    )
    rest = {"no_base_watchdog": False}
    base, _ = open_base(choose_base("mine/10.0.0.1:9", "turtlebot4"), Limits(), Inbox(), None, **rest)
    assert base == "its base"
    assert opened[0][:2] == ("10.0.0.1:9", load_description("turtlebot4"))
    with pytest.raises(UsageError, match="cannot be loaded"):
        open_base(choose_base("bad/x", "turtlebot4"), Limits(), Inbox(), None, **rest)
    with pytest.raises(UsageError, match="only a Pioneer says what it is"):
        choose_base("mine/x", "auto")


def test_base_that_fails_before_it_was_ready_ends_the_bridge_in_one_line():
    rig = Watched()
    rig.connection.base.receive = lambda arrival, now: [Failed("it is no ARCOS base")]
    with pytest.raises(NoRobot, match="it is no ARCOS base"):
        rig.serve()
    assert rig.driven == [STOP]
    assert rig.calls[-1] == "close"


@pytest.mark.parametrize("fenced", [True, False])
@pytest.mark.parametrize("again", [Ready("x", ROBOT), Recovered()], ids=["ready", "recovered"])
def test_base_that_is_ready_again_has_other_odometry_and_one_that_recovers_the_same(fenced, again):
    rig = VirtualRig(ROBOT, limits=FENCED if fenced else None)
    rig.sleep(3.0)
    rig._node._handle([Lost("x"), again], rig.monotonic())
    rig.sleep(0.2)
    reply = VirtualDriver(rig).motors()
    assert reply.granted is (not fenced or again == Recovered())
    assert reply.granted or reply.reason == "fence-lost"


def test_the_log_names_who_takes_a_drive_over(caplog):
    """Where no certificates are in use, three messages of any peer do."""
    caplog.set_level("INFO", "rover_ncp")
    rig, enable = driven(), b'{"enable": true, "name": "x"}'
    for name, payload, source in (
        ("rover/stop", b'{"reason": "mine"}', "f00d"),
        ("rover/stop", b'{"release": true}', ""),
        ("rover/motors", enable, "f00d"),
    ):
        rig._inbox.append(Query(name, payload, None, caplog.messages.append, caplog.messages.append, source))
        rig.sleep(0.02)
    assert "the peer with the Zenoh id f00d requests a stop: mine" in caplog.text
    assert "a peer that states no Zenoh id requests the release of the stop" in caplog.text
    assert "the lease is that of the peer with the Zenoh id f00d" in caplog.text


def test_the_log_names_a_button_that_was_pressed_while_the_line_was_down(caplog):
    caplog.set_level("INFO", "rover_ncp")
    rig = Watched()
    for faults, seconds in (((), 3.0), (("mute", "stop-button"), 1.5), (("stop-button",), 0.5), ((), 0.5)):
        rig.base._faults = Faults([parse_fault(fault) for fault in faults])
        rig.sleep(seconds)
    said = [line for line in caplog.messages if line.startswith((LOST, BACK, HAZARD, STOPPED))]
    assert said[0].startswith(LOST)
    assert said[1:] == [BACK, f"{HAZARD}stop-button"]


def test_a_loose_contact_does_not_fill_the_log(caplog):
    caplog.set_level("INFO", "rover_ncp")
    rig = Watched()
    rig.sleep(3.0)
    for number in range(61):
        rig.base._faults = Faults([parse_fault("bumper")] if number % 2 else [])
        rig.sleep(0.1)
    rig.sleep(2.0)
    rig.base._faults = Faults([parse_fault("bumper")])
    rig.sleep(0.2)
    assert caplog.messages.count(f"{HAZARD}bumper") == 2
