"""The safety matrix: every fault, how it is injected into a running `Rig`, and how soon the rover must stand.

The one table behind ``docs/measured`` and the tests of the matrix. A row that is missing in
one of them fails a test.

A fault acts on a moving rover that a circuit or a scripted driver drives. It needs no help from the processes
under test. After the measurement the fault is removed, and the rover must not move then.
"""

import math
import time
from collections.abc import Callable
from functools import partial
from signal import SIGCONT, SIGKILL, SIGSTOP, SIGUSR1
from typing import Any

from kit.true_motion import states_since

from faults.going_on import CLOCK_ROWS, OWN_ROWS, ROS2_ROWS, SILENT_CLOSE_ROW, silence, start_bridge
from faults.hang import CLOCK_STEPS_S, HANG_S
from faults.outlet import GONE, PIPE, TERMINAL, OutletProcess
from faults.rig import SPEED_M_S, Scene, Unsafe
from faults.row import CIRCUIT, SCRIPTED, Act, Row
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.wire.messages import odometry, text, twist_stamped
from rover_ncp.wire.protocol import CONTACTS
from sim.park.live import Process, wait_for

LONG_LEASE_S = 30.0
"""With a lease that long, Zenoh itself does not detect a link that is held."""
LATE_S = 5.0
FLOOD_S, FLOOD_PER_S = 1.5, 10_000


# Injections of faults, and their removal.


def _tell(process: str, line: str) -> Act:
    """Return a fault that the rig's ``mock``, ``line`` or ``link`` causes."""
    return lambda scene: getattr(scene.rig, process).tell(line).t_ns


_hold, _release = _tell("link", "hold"), _tell("link", "release")


def _signal_driver(number: int) -> Act:
    return lambda scene: scene.process.send_signal(number)


def _signal_bridge(number: int) -> Act:
    return lambda scene: scene.rig.bridge.send_signal(number)


def _hang(process: Process) -> int:
    return process.answer_to(lambda: process.send_signal(SIGUSR1)).t_ns


def _payload(data: bytes) -> Act:
    return lambda scene: setattr(scene.scripted, "payload", data)


def _clock_back(scene: Scene) -> None:
    scene.scripted.age_s = 3600.0


def _resume_bridge(scene: Scene) -> None:
    """Let a stopped bridge continue; many old commands wait for it."""
    scene.request_no_lease()
    scene.rig.bridge.send_signal(SIGCONT)


def _outlast_hang(scene: Scene) -> None:
    """Wait until the bridge's hang ends; many old commands wait for it."""
    scene.request_no_lease()
    # The base's watchdog stopped the rover after 2 s. The hang ends at least 1 s before this.
    time.sleep(HANG_S - 1.0)


def _release_without_lease(scene: Scene) -> None:
    """Release the link once the lease has lapsed; an earlier release would only pause the drive."""
    wait_for(lambda: not scene.rig.watcher.gate.lease, what="the lease to lapse")
    _release(scene)


def _hold_commands(scene: Scene) -> int | None:
    """Hold only commands, and no requests for the lease."""
    held_ns = _hold(scene)
    scene.request_no_lease()
    return held_ns


def _deliver_late(scene: Scene) -> None:
    """Release the held commands when the first of them are `LATE_S` old, and wait until all are dropped."""
    time.sleep(LATE_S - 1.0)
    dropped = scene.dropped()
    silence(scene)
    _release(scene)
    wait_for(lambda: scene.dropped() - dropped > 70, what="the old commands to arrive")


def _hold_first_commands(scene: Scene) -> int:
    """Hold the first commands of a drive until most of them are old, then deliver them."""
    driver = scene.scripted
    wait_for(lambda: driver.driving, what="the lease")
    held_ns = _hold_commands(scene) or 0
    driver.velocity, driver.silent = Velocity(SPEED_M_S, 0.0), False
    time.sleep(0.8)  # the lease is still valid when they arrive
    dropped = scene.dropped()
    silence(scene)
    _release(scene)
    wait_for(lambda: scene.dropped() - dropped > 8, what="the old commands to be dropped")
    if any(abs(state.velocity.v) >= SPEED_M_S for state in states_since(scene.rig.truth, held_ns)):
        raise Unsafe("old commands drove the rover")
    # Commands of the last 0.2 s are fresh; each of them is valid for 0.3 s.
    return driver.last_sent_ns


def _release_slow_link(scene: Scene) -> None:
    wait_for(lambda: scene.scripted.gate.dropped.get("stale", 0), what="a stale command")
    wait_for(lambda: not scene.scripted.gate.lease, what="the lease to lapse")
    silence(scene)
    _release(scene)


def _foreign_publisher(scene: Scene) -> int:
    """Let a foreign publisher send other commands; then silence the driver that has the lease."""
    rig = scene.rig
    stranger = rig.scripted_driver()
    stranger.requests_lease, stranger.velocity = False, Velocity(-0.3, 0.6)
    began_ns = time.monotonic_ns()
    time.sleep(0.5)
    velocities = [state.velocity for state in states_since(rig.truth, began_ns)]
    if any(omega != 0.0 or abs(v - SPEED_M_S) > 0.02 for v, omega in velocities):
        raise Unsafe("a foreign publisher moved the rover")
    silent_ns = time.monotonic_ns()
    silence(scene)
    time.sleep(1.0)
    rig.end(stranger)
    return silent_ns


def _flood(scene: Scene) -> int:
    """Let a foreign publisher send commands as fast as it can while the driver falls silent."""
    stranger = scene.rig.scripted_driver()
    stranger.requests_lease, stranger.silent = False, True
    command, sent, began = twist_stamped(Velocity(0.3, 0.0), 0), 0, time.monotonic()
    silent_ns = time.monotonic_ns()
    silence(scene)
    while (elapsed := time.monotonic() - began) < FLOOD_S:
        if sent < elapsed * FLOOD_PER_S:
            stranger.put(command)
            sent += 1
        else:  # a stranger's computer takes no time from the robot's
            time.sleep(0.001)
    scene.note = f"{sent / FLOOD_S:,.0f} a second"
    scene.rig.end(stranger)
    return silent_ns


def _request_stop(scene: Scene) -> None:
    if not scene.rig.watcher.stop():
        raise Unsafe("the bridge does not answer rover/stop")


# The rows.

_GOOD = twist_stamped(Velocity(0.2, 0.0), 0)
_NAN = twist_stamped(Velocity(math.nan, 0.0), 0)
_INFINITE = twist_stamped(Velocity(0.1, -math.inf), 0)
_ODOMETRY = odometry(Pose(0.2, 0.2, 0.2), Velocity(0.2, 0.2), 0)
_LAPSED, _NO_BASE = "lease-lapsed", "no-base"
_HUNG = "hung, the interpreter's lock held"
_PULLED = "to the base pulled: nothing comes, nothing goes"


def _until_free(scene: Scene) -> None:
    """Wait for the end of a contact. A lease that is granted before needs a zero command after it."""
    wait_for(lambda: scene.rig.watcher.gate.held not in CONTACTS, what="the end of the contact")


def _base(key: str, fault: str, line: str, ended: str = "", **more: Any) -> Row:
    return Row(key, "base", fault, _tell("mock", line), ended=ended, **more)


def _deploy(key: str, fault: str, act: Act, mend: Act = lambda scene: None) -> Row:
    return Row(key, "deploy", fault, act, mend, only=CIRCUIT)


def _link(key: str, fault: str, act: Act, mend: Callable[[Scene], object], **more: Any) -> Row:
    return Row(key, "link", fault, act, mend, **{"only": SCRIPTED} | more)


def _command(key: str, fault: str, act: Act) -> Row:
    return Row(key, "command", fault, act, only=SCRIPTED)


# The gate grants a lease to drive away from a bumper or a stall.
_BUMPER = _base("bumper", "bumper", "bumper@0-1.5", "bumper", requests_lease=False, mend=_until_free)
_STALL = _base("stall", "stall", "stall@0-1.5", "stall", requests_lease=False, mend=_until_free)
_STOP_BUTTON = _base("stop-button", "stop button", "stop-button@0-1.5", "stop-button")

_ROWS = (
    _base("odometry-frozen", "odometry frozen, SIPs go on", "freeze-odometry@0-3", "odometry-frozen"),
    _base("odometry-jumps", "odometry jumps by 0.5 m", "jump-odometry@0-3", only=CIRCUIT),
    _base("mute", "mute (no SIPs)", "mute@0-2", _NO_BASE),
    *(_BUMPER, _STALL, _STOP_BUTTON),
    _base(
        "bumper-again",
        "bumper, and the driver asks again and drives on",
        "bumper@0-1.5",
        only=SCRIPTED,
        mend=lambda scene: time.sleep(2.0),  # the gate holds a driver that drives on beyond the contact's end
    ),
    _base("low-battery", "low battery (2 s below 11 V)", "low-battery=10@0-4", "low-battery"),
    _base("restart", "restarts", "reset@0-0.05", _NO_BASE, requests_lease=False),
    SILENT_CLOSE_ROW,
    Row("wall", "base", "a wall within `sonar_stop_m`"),  # a test of its own: it needs another course
    *OWN_ROWS,
    Row(
        "line-reset",
        "line",
        "to the base cut by a TCP reset",
        _tell("line", "reset"),
        ended=_NO_BASE,
        requests_lease=False,
    ),
    Row("line-pulled", "line", _PULLED, _tell("line", "hold_both_ways"), _tell("line", "release"), _NO_BASE),
    _deploy("deploy-killed", "killed (SIGKILL)", _signal_driver(SIGKILL)),
    _deploy("deploy-stopped", "stopped (SIGSTOP)", _signal_driver(SIGSTOP), _signal_driver(SIGCONT)),
    _deploy("deploy-hung", _HUNG, lambda scene: _hang(scene.process), _signal_driver(SIGKILL)),
    _link("deploy-held", "deploy's link held back", _hold, _release_without_lease, only=CIRCUIT),
    _link(
        "link-late",
        "commands 5 s late, all arrive",
        _hold_commands,
        _deliver_late,
        lease_s=LONG_LEASE_S,
        ended=_LAPSED,
    ),
    _link("link-cut", "cut", _tell("link", "cut"), _release_without_lease, only=""),
    # The driver sends only commands: a late request for the lease would make stale commands look fresh.
    _link(
        "link-slow",
        "slow: 1 kB/s, commands later and later",
        _tell("link", "throttle 1000"),
        _release_slow_link,
        requests_lease=False,
    ),
    _link(
        "link-held-first",
        "held back before the first command",
        _hold_first_commands,
        _release,
        lease_s=LONG_LEASE_S,
        from_rest=True,
    ),
    _command("not-a-number", "not a number", _payload(_NAN)),
    _command("infinite", "infinite", _payload(_INFINITE)),
    _command("truncated", "truncated", _payload(_GOOD[:-5])),
    _command("oversized", "oversized", _payload(_GOOD + bytes(500_000))),
    _command("another-type", "of another type", _payload(_ODOMETRY)),
    _command("no-type", "of no type", _payload(text("forward!"))),
    _command("clock-back", "stamped an hour ago", _clock_back),
    _command("foreign", "a foreign publisher goes on", _foreign_publisher),
    _command("flood", "a flood of commands", _flood),
    *CLOCK_ROWS,
    Row("bridge-stopped", "bridge", "stopped (SIGSTOP)", _signal_bridge(SIGSTOP), _resume_bridge),
    Row("bridge-hung", "bridge", _HUNG, lambda scene: _hang(scene.rig.bridge), _outlast_hang),
    Row("bridge-killed", "bridge", "killed (SIGKILL)", _signal_bridge(SIGKILL), start_bridge),
)
_STOP_QUERY = Row(
    *("stop-query", "", "`rover/stop`", _request_stop),
    lambda scene: scene.rig.watcher.stop(release=True),
    "stopped",
)
_SILENCE = Row("silence", "", "no more commands", silence, ended=_LAPSED, requests_lease=False)


def _blocked(outlet: str, state: str, *rows: Row) -> tuple[Row, ...]:
    """Return rows that begin when the bridge's output has just been blocked: the bridge cannot log them."""

    def block(scene: Scene, act: Act) -> int | None:
        assert isinstance(scene.rig.bridge, OutletProcess)  # the row names an outlet
        scene.rig.bridge.outlet.block()
        return act(scene)

    return tuple(
        row._replace(
            key=f"{outlet}-{row.key}",
            layer="output",
            fault=f"{state}, then {row.fault}",
            act=partial(block, act=row.act),
            only=SCRIPTED,
            outlet=outlet,
        )
        for row in rows
    )


MATRIX: tuple[Row, ...] = (
    *_ROWS,
    *_blocked(TERMINAL, "the bridge's terminal stopped (Ctrl-S)", _BUMPER, _STOP_QUERY),
    *_blocked(PIPE, "the bridge's pipe full", _STALL, _SILENCE),
    *_blocked(GONE, "the bridge's reader gone", _STOP_BUTTON),
)
ROWS = {row.key: row for row in (*MATRIX, *ROS2_ROWS)}

_ROWS_OF_A_PIONEER_ALONE = {
    "bumper": "this robot has none",
    "stall": "this robot reports none",
    "bumper-again": "this robot has none",
    "line-reset": "Zenoh connects again within 0.2 s, and the drive goes on",
    **{
        f"bridge-clock-{step_s:g}": "it drops commands with old stamps: both clocks must agree"
        for step_s in CLOCK_STEPS_S.values()
    },
}
# Rows without an act have tests of their own.
ROS2_KEYS = [
    row.key
    for row in (*MATRIX, *ROS2_ROWS)
    if row.act and not row.outlet and row.key not in _ROWS_OF_A_PIONEER_ALONE
]
