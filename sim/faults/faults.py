"""The fault of each row of the safety matrix: its injection into a `Rig` and its removal.

A fault acts on a moving rover that a circuit or a scripted driver drives. It needs no help from the processes
under test. After the measurement the fault is removed, and the rover must not move then.
"""

import math
import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.core.messages import odometry, text, twist_stamped
from sim.faults.hang import HANG_S
from sim.faults.outlet import OUTLETS
from sim.faults.proxy import Proxy
from sim.faults.rig import SPEED_M_S, Rig, Unsafe, wait_for
from sim.faults.scripted_driver import ScriptedDriver
from sim.live.processes import Process

LATE_S = 5.0
FLOOD_S, FLOOD_PER_S = 1.5, 10_000
NAN_S, NAN_PERIOD_S = 1.0, 0.01
LONG_LEASE_S = 30.0
"""With a lease that long, Zenoh itself does not detect a link that is held."""

CIRCUIT, SCRIPTED = "circuit", "hand"
"""The drivers, as the ``driver`` field of a soak's JSON names them."""
BOTH = (SCRIPTED, CIRCUIT)


@dataclass
class Scene:
    """A rig and its driver: a scripted driver, or the process of a circuit."""

    rig: Rig
    driver: ScriptedDriver | Process
    note: str = ""
    """A property of this injection, if injections differ."""

    @property
    def scripted(self) -> ScriptedDriver:
        """The driver, which must be a scripted one."""
        assert isinstance(self.driver, ScriptedDriver)
        return self.driver

    @property
    def process(self) -> Process:
        """The driver, which must be a process."""
        assert isinstance(self.driver, Process)
        return self.driver


def _nothing(scene: Scene) -> None:
    """Do nothing: the fault ends by itself."""


class Fault(NamedTuple):
    """``act`` returns when the fault began, in ns of the monotonic clock; None for the time of its call."""

    act: Callable[[Scene], int | None]
    mend: Callable[[Scene], None] = _nothing
    drivers: tuple[str, ...] = BOTH
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


def _base(
    fault: str, ended: str = "", drivers: tuple[str, ...] = BOTH, *, requests_lease: bool = True
) -> Fault:
    return Fault(
        lambda scene: scene.rig.mock.tell(fault).t_ns,
        ended=ended,
        drivers=drivers,
        requests_lease=requests_lease,
    )


def _strange_odometry(scene: Scene) -> None:
    """Publish odometry that is not a number, ten times as often as the base publishes its own."""
    end = time.monotonic() + NAN_S
    while time.monotonic() < end:
        nowhere = odometry(Pose(math.nan, math.nan, math.nan), Velocity(math.nan, 0.0), time.time_ns())
        scene.rig.watcher.publish("odom", nowhere)
        time.sleep(NAN_PERIOD_S)


def _signalled(number: int) -> Callable[[Scene], None]:
    return lambda scene: scene.process.send_signal(number)


def _bridge_signalled(number: int) -> Callable[[Scene], None]:
    return lambda scene: scene.rig.bridge.send_signal(number)


def _hung(process: Process) -> int:
    return process.answer_to(lambda: process.send_signal(signal.SIGUSR1)).t_ns


def _bridge_resumes(scene: Scene) -> None:
    """Let the bridge continue; many old commands wait for it."""
    if isinstance(scene.driver, ScriptedDriver):
        scene.driver.requests_lease = False
    scene.rig.bridge.send_signal(signal.SIGCONT)


def _bridge_wakes(scene: Scene) -> None:
    if isinstance(scene.driver, ScriptedDriver):
        scene.driver.requests_lease = False
    # The base's watchdog stopped the rover after 2 s. The hang ends at least 1 s before this.
    time.sleep(HANG_S - 1.0)


def _release(link: Proxy) -> None:
    link.release()


def _release_without_lease(scene: Scene) -> None:
    """Release the link once the lease has lapsed; an earlier release would only pause the drive."""
    wait_for(lambda: not scene.rig.watcher.gate.lease, "the lease to lapse")
    scene.rig.link.release()


def _deliver_late(scene: Scene) -> int:
    """Hold only commands, and no requests for the lease."""
    held = scene.rig.link.hold()
    scene.scripted.requests_lease = False
    return held.t_ns


def _all_arrive(scene: Scene) -> None:
    driver = scene.scripted
    time.sleep(LATE_S - 1.0)
    dropped = sum(driver.gate.dropped.values())
    driver.silent = True
    scene.rig.link.release()
    wait_for(lambda: sum(driver.gate.dropped.values()) - dropped > 70, "the old commands to arrive")


def _held_before_the_first(scene: Scene) -> int:
    rig, driver = scene.rig, scene.scripted
    wait_for(lambda: driver.driving, "the lease")
    driver.requests_lease = False
    held_ns = rig.link.hold().t_ns
    driver.velocity, driver.silent = Velocity(SPEED_M_S, 0.0), False
    time.sleep(0.8)  # the lease is still valid when they arrive
    dropped = sum(driver.gate.dropped.values())
    driver.silent = True
    rig.link.release()
    wait_for(lambda: sum(driver.gate.dropped.values()) - dropped > 8, "the old commands to be dropped")
    if any(abs(row.v) >= SPEED_M_S for row in rig.truth.since(held_ns)):
        raise Unsafe("old commands drove the rover")
    # Commands of the last 0.2 s are fresh; each of them is valid for 0.3 s.
    return driver.last_sent_ns


def _back_from_slow(scene: Scene) -> None:
    driver = scene.scripted
    wait_for(lambda: driver.gate.dropped.get("stale", 0) > 0, "a stale command")
    wait_for(lambda: not driver.gate.lease, "the lease to lapse")
    driver.silent = True
    scene.rig.link.release()


def _says(payload: bytes) -> Fault:
    def act(scene: Scene) -> None:
        scene.scripted.payload = payload

    return Fault(act, drivers=(SCRIPTED,))


def _clock_back(scene: Scene) -> None:
    scene.scripted.age_s = 3600.0


def _foreign_goes_on(scene: Scene) -> int:
    """Let a foreign publisher send other commands; then silence the driver that has the lease."""
    rig = scene.rig
    stranger = rig.scripted_driver()
    stranger.requests_lease, stranger.velocity = False, Velocity(-0.3, 0.6)
    began_ns = time.monotonic_ns()
    time.sleep(0.5)
    if any(row.omega != 0.0 or abs(row.v - SPEED_M_S) > 0.02 for row in rig.truth.since(began_ns)):
        raise Unsafe("a foreign publisher moved the rover")
    silent_ns = time.monotonic_ns()
    scene.scripted.silent = True
    time.sleep(1.0)
    rig.leave(stranger)
    return silent_ns


def _flood(scene: Scene) -> int:
    stranger = scene.rig.scripted_driver()
    stranger.requests_lease, stranger.silent = False, True
    payload, sent, began = twist_stamped(Velocity(0.3, 0.0), 0), 0, time.monotonic()
    silent_ns = time.monotonic_ns()
    scene.scripted.silent = True
    while (elapsed := time.monotonic() - began) < FLOOD_S:
        if sent < elapsed * FLOOD_PER_S:
            stranger.send(payload)
            sent += 1
    scene.note = f"{sent / FLOOD_S:,.0f} a second"
    scene.rig.leave(stranger)
    return silent_ns


def _stop_asked(scene: Scene) -> None:
    if not scene.rig.watcher.stop():
        raise Unsafe("the bridge does not answer rover/stop")


def _stop_released(scene: Scene) -> None:
    scene.rig.watcher.stop(release=True)


def _silent(scene: Scene) -> None:
    scene.scripted.silent = True


def _with_outlet_blocked(fault: Fault) -> Fault:
    """Return the fault with the bridge's output blocked: the bridge cannot log it."""

    def act(scene: Scene) -> int | None:
        assert scene.rig.bridge.outlet is not None  # the row names an outlet
        scene.rig.bridge.outlet.block()
        return fault.act(scene)

    return fault._replace(act=act, drivers=(SCRIPTED,))


_GOOD = twist_stamped(Velocity(0.2, 0.0), 0)

_WITHOUT_OUTLET: Mapping[str, Fault] = {
    "odometry-frozen": _base("freeze-odometry@0-3", "odometry-frozen"),
    "odometry-jumps": _base("jump-odometry@0-3", drivers=(CIRCUIT,)),
    "odometry-nan": Fault(_strange_odometry, drivers=(CIRCUIT,)),
    "mute": _base("mute@0-2", "no-base"),
    "bumper": _base("bumper@0-1.5", "bumper"),
    "stall": _base("stall@0-1.5", "stall"),
    "stop-button": _base("stop-button@0-1.5", "stop-button"),
    "low-battery": _base("low-battery=10@0-4", "low-battery"),
    "restart": _base("reset@0-0.05", "no-base", requests_lease=False),
    "line-reset": Fault(lambda scene: scene.rig.line.reset().t_ns, ended="no-base", requests_lease=False),
    "line-pulled": Fault(
        lambda scene: scene.rig.line.hold_both_ways().t_ns,
        lambda scene: _release(scene.rig.line),
        ended="no-base",
    ),
    "deploy-killed": Fault(_signalled(signal.SIGKILL), drivers=(CIRCUIT,)),
    "deploy-stopped": Fault(
        _signalled(signal.SIGSTOP), _signalled(signal.SIGCONT), drivers=(CIRCUIT,), losing=True
    ),
    "deploy-hung": Fault(
        lambda scene: _hung(scene.process), _signalled(signal.SIGKILL), drivers=(CIRCUIT,), losing=True
    ),
    "deploy-held": Fault(
        lambda scene: scene.rig.link.hold().t_ns,
        _release_without_lease,
        drivers=(CIRCUIT,),
        link_fault=True,
        losing=True,
    ),
    "link-late": Fault(
        _deliver_late,
        _all_arrive,
        drivers=(SCRIPTED,),
        link_fault=True,
        lease_s=LONG_LEASE_S,
        ended="lease-lapsed",
    ),
    "link-cut": Fault(
        lambda scene: scene.rig.link.cut().t_ns,
        lambda scene: _release(scene.rig.link),
        link_fault=True,
        losing=True,
    ),
    "link-slow": Fault(
        # The driver sends only commands: a late request for the lease would make stale commands look fresh.
        lambda scene: scene.rig.link.throttle(1000).t_ns,
        _back_from_slow,
        drivers=(SCRIPTED,),
        link_fault=True,
        requests_lease=False,
    ),
    "link-held-first": Fault(
        _held_before_the_first, drivers=(SCRIPTED,), link_fault=True, lease_s=LONG_LEASE_S, from_rest=True
    ),
    "not-a-number": _says(twist_stamped(Velocity(math.nan, 0.0), 0)),
    "infinite": _says(twist_stamped(Velocity(0.1, -math.inf), 0)),
    "truncated": _says(_GOOD[:-5]),
    "oversized": _says(_GOOD + bytes(500_000)),
    "another-type": _says(odometry(Pose(0.2, 0.2, 0.2), Velocity(0.2, 0.2), 0)),
    "no-type": _says(text("forward!")),
    "clock-back": Fault(_clock_back, drivers=(SCRIPTED,)),
    "foreign": Fault(_foreign_goes_on, drivers=(SCRIPTED,)),
    "flood": Fault(_flood, drivers=(SCRIPTED,)),
    "bridge-stopped": Fault(_bridge_signalled(signal.SIGSTOP), _bridge_resumes, losing=True),
    "bridge-hung": Fault(lambda scene: _hung(scene.rig.bridge), _bridge_wakes, losing=True),
    "bridge-killed": Fault(
        _bridge_signalled(signal.SIGKILL), lambda scene: scene.rig.start_bridge(), losing=True
    ),
}
_WITH_OUTLET: Mapping[str, Fault] = {
    **{key: _WITHOUT_OUTLET[key] for key in ("bumper", "stall", "stop-button")},
    "stop-query": Fault(_stop_asked, _stop_released, ended="stopped"),
    "silence": Fault(_silent, ended="lease-lapsed", requests_lease=False),
}

FAULTS: Mapping[str, Fault] = {
    **_WITHOUT_OUTLET,
    **{
        f"{outlet}-{key}": _with_outlet_blocked(fault)
        for outlet in OUTLETS
        for key, fault in _WITH_OUTLET.items()
    },
}
"""Faults by the key of the matrix's row."""
