"""The rows of the safety matrix: every fault, its injection, and how soon the rover must stand after it.

The one table behind ``docs/safety.md``, the tests of the matrix and ``rover-ncp soak``. A row that is missing
in one of them fails a test.
"""

import math
import signal
from collections.abc import Callable
from typing import Any, NamedTuple

from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.core.messages import odometry, text, twist_stamped
from sim.faults import injections as inject
from sim.faults.injections import Scene
from sim.faults.scripted_driver import NAME
from sim.live.processes import GONE, PIPE, TERMINAL

STOP_S, WATCHDOG_S = 0.5, 2.0
"""The first safety requirement, and the base's own watchdog."""
LOW_BATTERY_S = 2.0
"""How long the voltage must be low before it counts: it sags when the motors start."""
BRAKING_M_S2, ALPHA_RAD_S2, DELAY_S = 0.31, 1.25, 0.15
"""The mock's, as a Pioneer's: what "plus braking" means."""
LONG_LEASE_S = 30.0
"""With a lease that long, Zenoh itself does not detect a link that is held."""

CIRCUIT, SCRIPTED = "circuit", NAME
"""The drivers, as the ``driver`` field of a soak's JSON names them."""


class Row(NamedTuple):
    """A fault of a layer; the rover stands within ``bound_s`` plus braking."""

    key: str
    layer: str
    fault: str
    act: Callable[[Scene], int | None] | None = None
    """Injects the fault into running processes and returns when it began, in ns of the monotonic clock, or
    None for the time of its call."""
    mend: Callable[[Scene], None] = inject.nothing
    """Removes the fault."""
    bound_s: float = STOP_S
    drivers: tuple[str, ...] = (SCRIPTED, CIRCUIT)
    ended: str = ""
    """The reason for which the gate ends the lease, if it always does."""
    link_fault: bool = False
    """Whether the fault is on the driver's own link, which then goes through the proxy."""
    lease_s: float = 1.0
    requests_lease: bool = True
    """Whether a scripted driver requests the lease again. False where the gate would grant it at once."""
    from_rest: bool = False
    """Whether the rover stands when the fault begins."""
    losing: bool = False
    """Whether the driver may miss messages from then on."""
    outlet: str = ""
    """The kind of `Outlet` that takes the bridge's output, which stops just before the fault."""

    @property
    def allowed(self) -> str:
        """The bound in words."""
        return f"{WATCHDOG_S:g} s + {STOP_S:g} s" if self.bound_s > WATCHDOG_S else f"{self.bound_s:g} s"


def _base(key: str, fault: str, line: str, ended: str = "", **more: Any) -> Row:
    """Return a row for a fault of the mock, in the words of ``mock --fault``."""
    row = Row(key, "base", fault, lambda scene: scene.rig.mock.tell(line).t_ns, ended=ended)
    return row._replace(**more)


def _line(key: str, fault: str, command: str, **more: Any) -> Row:
    """Return a row for a fault of the line to the base, in the words of the proxy."""
    row = Row(key, "line", fault, lambda scene: scene.rig.line.tell(command).t_ns, inject.release_line)
    return row._replace(bound_s=WATCHDOG_S, ended="no-base", **more)


def _payload(key: str, fault: str, payload: bytes) -> Row:
    """Return a row for a driver that sends a payload instead of its commands."""
    return Row(key, "command", fault, inject.payload(payload), drivers=(SCRIPTED,))


_GOOD = twist_stamped(Velocity(0.2, 0.0), 0)

_BASE = (
    _base("odometry-frozen", "odometry frozen, SIPs go on", "freeze-odometry@0-3", "odometry-frozen"),
    _base("odometry-jumps", "odometry jumps by 0.5 m", "jump-odometry@0-3", drivers=(CIRCUIT,)),
    Row(
        "odometry-nan",
        "base",
        "odometry not a number, between the base's own",
        inject.nan_odometry,
        drivers=(CIRCUIT,),
    ),
    _base("mute", "mute (no SIPs)", "mute@0-2", "no-base"),
    _base("bumper", "bumper", "bumper@0-1.5", "bumper"),
    _base("stall", "stall", "stall@0-1.5", "stall"),
    _base("stop-button", "stop button", "stop-button@0-1.5", "stop-button"),
    _base(
        "low-battery",
        "low battery (2 s below 11 V)",
        "low-battery=10@0-4",
        "low-battery",
        bound_s=LOW_BATTERY_S + STOP_S,
    ),
    _base("restart", "restarts", "reset@0-0.05", "no-base", requests_lease=False),
    Row("wall", "base", "a wall within `sonar_stop_m`"),  # a test of its own: it needs another course
)
_LINKS = (
    _line("line-reset", "to the base cut by a TCP reset", "reset", requests_lease=False),
    _line("line-pulled", "to the base pulled: nothing comes, nothing goes", "hold_both_ways"),
    Row(
        "deploy-killed",
        "deploy",
        "killed (SIGKILL)",
        inject.signal_driver(signal.SIGKILL),
        drivers=(CIRCUIT,),
    ),
    Row(
        "deploy-stopped",
        "deploy",
        "stopped (SIGSTOP)",
        inject.signal_driver(signal.SIGSTOP),
        inject.signal_driver(signal.SIGCONT),
        drivers=(CIRCUIT,),
        losing=True,
    ),
    Row(
        "deploy-hung",
        "deploy",
        "hung, the interpreter's lock held",
        lambda scene: inject.hang(scene.process),
        inject.signal_driver(signal.SIGKILL),
        drivers=(CIRCUIT,),
        losing=True,
    ),
    Row(
        "deploy-held",
        "link",
        "deploy's link held back",
        inject.hold_link,
        inject.release_link_without_lease,
        drivers=(CIRCUIT,),
        link_fault=True,
        losing=True,
    ),
    Row(
        "link-late",
        "link",
        "commands 5 s late, all arrive",
        inject.hold_commands,
        inject.deliver_late,
        drivers=(SCRIPTED,),
        link_fault=True,
        lease_s=LONG_LEASE_S,
        ended="lease-lapsed",
    ),
    Row(
        "link-cut",
        "link",
        "cut",
        lambda scene: scene.rig.link.tell("cut").t_ns,
        inject.release_link,
        link_fault=True,
        losing=True,
    ),
    Row(
        "link-slow",
        "link",
        "slow: 1 kB/s, commands later and later",
        # The driver sends only commands: a late request for the lease would make stale commands look fresh.
        lambda scene: scene.rig.link.tell("throttle 1000").t_ns,
        inject.release_slow_link,
        drivers=(SCRIPTED,),
        link_fault=True,
        requests_lease=False,
    ),
    Row(
        "link-held-first",
        "link",
        "held back before the first command",
        inject.hold_before_first_command,
        drivers=(SCRIPTED,),
        link_fault=True,
        lease_s=LONG_LEASE_S,
        from_rest=True,
    ),
)
_COMMANDS = (
    _payload("not-a-number", "not a number", twist_stamped(Velocity(math.nan, 0.0), 0)),
    _payload("infinite", "infinite", twist_stamped(Velocity(0.1, -math.inf), 0)),
    _payload("truncated", "truncated", _GOOD[:-5]),
    _payload("oversized", "oversized", _GOOD + bytes(500_000)),
    _payload("another-type", "of another type", odometry(Pose(0.2, 0.2, 0.2), Velocity(0.2, 0.2), 0)),
    _payload("no-type", "of no type", text("forward!")),
    Row("clock-back", "command", "stamped an hour ago", inject.clock_back, drivers=(SCRIPTED,)),
    Row("foreign", "command", "a foreign publisher goes on", inject.foreign_publisher, drivers=(SCRIPTED,)),
    Row("flood", "command", "a flood of commands", inject.flood, drivers=(SCRIPTED,)),
)
_BRIDGE = (
    Row(
        "bridge-stopped",
        "bridge",
        "stopped (SIGSTOP)",
        inject.signal_bridge(signal.SIGSTOP),
        inject.resume_bridge,
        WATCHDOG_S,
        losing=True,
    ),
    Row(
        "bridge-hung",
        "bridge",
        "hung, the interpreter's lock held",
        lambda scene: inject.hang(scene.rig.bridge),
        inject.wait_for_hung_bridge,
        WATCHDOG_S,
        losing=True,
    ),
    Row(
        "bridge-killed",
        "bridge",
        "killed (SIGKILL)",
        inject.signal_bridge(signal.SIGKILL),
        lambda scene: scene.rig.start_bridge(),
        WATCHDOG_S,
        losing=True,
    ),
)
_OUTLETS = {
    TERMINAL: "the bridge's terminal stopped (Ctrl-S)",
    PIPE: "the bridge's pipe full",
    GONE: "the bridge's reader gone",
}
_WITH_OUTLET = (
    *(row for row in _BASE if row.key in {"bumper", "stall", "stop-button"}),
    Row("stop-query", "", "`rover/stop`", inject.request_stop, inject.release_stop, ended="stopped"),
    Row("silence", "", "no more commands", inject.silence, ended="lease-lapsed", requests_lease=False),
)

MATRIX: tuple[Row, ...] = (
    *(*_BASE, *_LINKS, *_COMMANDS, *_BRIDGE),
    *(
        row._replace(
            key=f"{outlet}-{row.key}",
            layer="output",
            fault=f"{state}, then {row.fault}",
            act=inject.with_outlet_blocked(row.act),
            drivers=(SCRIPTED,),
            outlet=outlet,
        )
        for outlet, state in _OUTLETS.items()
        for row in _WITH_OUTLET
        if row.act is not None
    ),
)
ROWS = {row.key: row for row in MATRIX}


def braking_s(v: float, omega: float = 0.0) -> float:
    """Return how long the base takes to stand, in s, from a speed in m/s and a turn rate in rad/s."""
    return DELAY_S + max(abs(v) / BRAKING_M_S2, abs(omega) / ALPHA_RAD_S2)
