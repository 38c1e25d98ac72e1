"""How the faults of the safety matrix are injected into a running `Rig`, and removed.

A fault acts on a moving rover that a circuit or a scripted driver drives. It needs no help from the processes
under test. After the measurement the fault is removed, and the rover must not move then. A function that
injects a fault returns when it began, in ns of the monotonic clock, or None for the time of its call.
"""

import math
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass

from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.core.messages import odometry, twist_stamped
from sim.faults.hang import HANG_S
from sim.faults.rig import SPEED_M_S, Rig, Unsafe
from sim.faults.scripted_driver import ScriptedDriver
from sim.live.processes import Process, wait_for

LATE_S = 5.0
FLOOD_S, FLOOD_PER_S = 1.5, 10_000
NAN_S, NAN_PERIOD_S = 1.0, 0.01


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

    def request_no_lease(self) -> None:
        """Stop a scripted driver from requesting the lease."""
        if isinstance(self.driver, ScriptedDriver):
            self.driver.requests_lease = False

    def dropped(self) -> int:
        """Return how many commands the gate has dropped."""
        return sum(self.scripted.gate.dropped.values())


def nothing(scene: Scene) -> None:
    """Do nothing: the fault ends by itself."""


def nan_odometry(scene: Scene) -> None:
    """Publish odometry that is not a number, ten times as often as the base publishes its own."""
    end = time.monotonic() + NAN_S
    while time.monotonic() < end:
        nowhere = odometry(Pose(math.nan, math.nan, math.nan), Velocity(math.nan, 0.0), time.time_ns())
        scene.rig.watcher.session.put("odom", nowhere)
        time.sleep(NAN_PERIOD_S)


def signal_driver(number: int) -> Callable[[Scene], None]:
    """Return a function that sends a signal to the driver's process."""
    return lambda scene: scene.process.send_signal(number)


def signal_bridge(number: int) -> Callable[[Scene], None]:
    """Return a function that sends a signal to the bridge."""
    return lambda scene: scene.rig.bridge.send_signal(number)


def hang(process: Process) -> int:
    """Make a process hang for `HANG_S`."""
    return process.answer_to(lambda: process.send_signal(signal.SIGUSR1)).t_ns


def resume_bridge(scene: Scene) -> None:
    """Let a stopped bridge continue; many old commands wait for it."""
    scene.request_no_lease()
    scene.rig.bridge.send_signal(signal.SIGCONT)


def wait_for_hung_bridge(scene: Scene) -> None:
    """Wait until the bridge's hang ends; many old commands wait for it."""
    scene.request_no_lease()
    # The base's watchdog stopped the rover after 2 s. The hang ends at least 1 s before this.
    time.sleep(HANG_S - 1.0)


def release_line(scene: Scene) -> None:
    """End every fault of the line to the base."""
    scene.rig.line.tell("release")


def release_link(scene: Scene) -> None:
    """End every fault of the driver's link."""
    scene.rig.link.tell("release")


def hold_link(scene: Scene) -> int:
    """Hold everything that the driver sends."""
    return scene.rig.link.tell("hold").t_ns


def release_link_without_lease(scene: Scene) -> None:
    """Release the link once the lease has lapsed; an earlier release would only pause the drive."""
    wait_for(lambda: not scene.rig.watcher.gate.lease, what="the lease to lapse")
    release_link(scene)


def hold_commands(scene: Scene) -> int:
    """Hold only commands, and no requests for the lease."""
    held_ns = hold_link(scene)
    scene.request_no_lease()
    return held_ns


def deliver_late(scene: Scene) -> None:
    """Release the held commands when the first of them are `LATE_S` old, and wait until all are dropped."""
    time.sleep(LATE_S - 1.0)
    dropped = scene.dropped()
    scene.scripted.silent = True
    release_link(scene)
    wait_for(lambda: scene.dropped() - dropped > 70, what="the old commands to arrive")


def hold_before_first_command(scene: Scene) -> int:
    """Hold the first commands of a drive until most of them are old, then deliver them."""
    rig, driver = scene.rig, scene.scripted
    wait_for(lambda: driver.driving, what="the lease")
    held_ns = hold_commands(scene)
    driver.velocity, driver.silent = Velocity(SPEED_M_S, 0.0), False
    time.sleep(0.8)  # the lease is still valid when they arrive
    dropped = scene.dropped()
    driver.silent = True
    release_link(scene)
    wait_for(lambda: scene.dropped() - dropped > 8, what="the old commands to be dropped")
    if any(abs(state.velocity.v) >= SPEED_M_S for state in rig.truth.since(held_ns)):
        raise Unsafe("old commands drove the rover")
    # Commands of the last 0.2 s are fresh; each of them is valid for 0.3 s.
    return driver.last_sent_ns


def release_slow_link(scene: Scene) -> None:
    """Release a slow link when stale commands have arrived and the lease has lapsed."""
    wait_for(lambda: scene.scripted.gate.dropped.get("stale", 0), what="a stale command")
    wait_for(lambda: not scene.scripted.gate.lease, what="the lease to lapse")
    scene.scripted.silent = True
    release_link(scene)


def payload(data: bytes) -> Callable[[Scene], None]:
    """Return a function that lets the driver send ``data`` instead of its commands."""

    def act(scene: Scene) -> None:
        scene.scripted.payload = data

    return act


def clock_back(scene: Scene) -> None:
    """Stamp the driver's commands an hour too early."""
    scene.scripted.age_s = 3600.0


def silence(scene: Scene) -> None:
    """Let the driver send no more commands."""
    scene.scripted.silent = True


def foreign_publisher(scene: Scene) -> int:
    """Let a foreign publisher send other commands; then silence the driver that has the lease."""
    rig = scene.rig
    stranger = rig.scripted_driver()
    stranger.requests_lease, stranger.velocity = False, Velocity(-0.3, 0.6)
    began_ns = time.monotonic_ns()
    time.sleep(0.5)
    velocities = [state.velocity for state in rig.truth.since(began_ns)]
    if any(omega != 0.0 or abs(v - SPEED_M_S) > 0.02 for v, omega in velocities):
        raise Unsafe("a foreign publisher moved the rover")
    silent_ns = time.monotonic_ns()
    silence(scene)
    time.sleep(1.0)
    rig.end(stranger)
    return silent_ns


def flood(scene: Scene) -> int:
    """Let a foreign publisher send commands as fast as it can while the driver falls silent."""
    stranger = scene.rig.scripted_driver()
    stranger.requests_lease, stranger.silent = False, True
    command, sent, began = twist_stamped(Velocity(0.3, 0.0), 0), 0, time.monotonic()
    silent_ns = time.monotonic_ns()
    silence(scene)
    while (elapsed := time.monotonic() - began) < FLOOD_S:
        if sent < elapsed * FLOOD_PER_S:
            stranger.send(command)
            sent += 1
    scene.note = f"{sent / FLOOD_S:,.0f} a second"
    scene.rig.end(stranger)
    return silent_ns


def request_stop(scene: Scene) -> None:
    """Stop the rover by a query."""
    if not scene.rig.watcher.stop():
        raise Unsafe("the bridge does not answer rover/stop")


def release_stop(scene: Scene) -> None:
    """Release that stop."""
    scene.rig.watcher.stop(release=True)


def with_outlet_blocked(act: Callable[[Scene], int | None]) -> Callable[[Scene], int | None]:
    """Return a fault that begins when the bridge's output has just been blocked: the bridge cannot log it."""

    def act_blocked(scene: Scene) -> int | None:
        assert scene.rig.bridge.outlet is not None  # the row names an outlet
        scene.rig.bridge.outlet.block()
        return act(scene)

    return act_blocked
