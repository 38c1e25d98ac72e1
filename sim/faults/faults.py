"""How each row of the safety matrix is brought about in a `Rig`, and mended again.

A mishap acts on a rover that is under way, under a circuit or under a steady hand, and never asks the
processes under test for help. After it was measured it is mended, by which the rover must not move.
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
from sim.faults.scripted_driver import Hand
from sim.live.processes import Process

LATE_S = 5.0
FLOOD_S, FLOOD_PER_S = 1.5, 10_000
NAN_S, NAN_PERIOD_S = 1.0, 0.01
LONG_LEASE_S = 30.0
"""With a lease that long Zenoh itself notices nothing of a link that is held back."""

CIRCUIT, HAND = "circuit", "hand"
BOTH = (HAND, CIRCUIT)


@dataclass
class Scene:
    """A rig and who drives in it: a hand or a circuit."""

    rig: Rig
    driver: Hand | Process
    note: str = ""
    """What the mishap was like this time, if that is not always the same."""

    @property
    def hand(self) -> Hand:
        """The driver, where only a hand will do."""
        assert isinstance(self.driver, Hand)
        return self.driver

    @property
    def process(self) -> Process:
        """The driver, where only a process will do."""
        assert isinstance(self.driver, Process)
        return self.driver


def _nothing(scene: Scene) -> None:
    """Mend what mends itself."""


class Mishap(NamedTuple):
    """``act`` returns from which moment on to count, in ns of the monotonic clock; None for its call."""

    act: Callable[[Scene], int | None]
    mend: Callable[[Scene], None] = _nothing
    drivers: tuple[str, ...] = BOTH
    ended: str = ""
    """By what the gate ends the lease, if it is sure to."""
    spoilt: bool = False
    """Whether the driver's own link is the matter."""
    lease_s: float = 1.0
    greedy: bool = True
    """Whether a hand goes on asking for the motors: not where it would have them again at once."""
    from_rest: bool = False
    """Whether the rover stands when it begins."""
    losing: bool = False
    """Whether from then on the driver cannot be expected to hear everything."""


def _base(fault: str, ended: str = "", drivers: tuple[str, ...] = BOTH, *, greedy: bool = True) -> Mishap:
    return Mishap(lambda scene: scene.rig.mock.tell(fault).t_ns, ended=ended, drivers=drivers, greedy=greedy)


def _strange_odometry(scene: Scene) -> None:
    """Somebody publishes odometry that is none, ten times as often as the base."""
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
    """It finds many old commands."""
    if isinstance(scene.driver, Hand):
        scene.driver.greedy = False
    scene.rig.bridge.send_signal(signal.SIGCONT)


def _bridge_wakes(scene: Scene) -> None:
    if isinstance(scene.driver, Hand):
        scene.driver.greedy = False
    # The rover stood once the base's watchdog had waited for 2 s: the hang ends at least 1 s before this.
    time.sleep(HANG_S - 1.0)


def _release(link: Proxy) -> None:
    link.release()


def _release_without_lease(scene: Scene) -> None:
    """A link that is good again within the lease is a mere pause."""
    wait_for(lambda: not scene.rig.watcher.gate.lease, "the lease to lapse")
    scene.rig.link.release()


def _deliver_late(scene: Scene) -> int:
    """Hold commands back, and nothing but commands."""
    held = scene.rig.link.hold()
    scene.hand.greedy = False
    return held.t_ns


def _all_arrive(scene: Scene) -> None:
    hand = scene.hand
    time.sleep(LATE_S - 1.0)
    dropped = sum(hand.gate.dropped.values())
    hand.silent = True
    scene.rig.link.release()
    wait_for(lambda: sum(hand.gate.dropped.values()) - dropped > 70, "the old commands to arrive")


def _held_before_the_first(scene: Scene) -> int:
    rig, hand = scene.rig, scene.hand
    wait_for(lambda: hand.driving, "the motors")
    hand.greedy = False
    held_ns = rig.link.hold().t_ns
    hand.velocity, hand.silent = Velocity(SPEED_M_S, 0.0), False
    time.sleep(0.8)  # the lease is still there when they arrive
    dropped = sum(hand.gate.dropped.values())
    hand.silent = True
    rig.link.release()
    wait_for(lambda: sum(hand.gate.dropped.values()) - dropped > 8, "the old commands to be dropped")
    if any(abs(row.v) >= SPEED_M_S for row in rig.truth.since(held_ns)):
        raise Unsafe("old commands drove the rover")
    # Those of the last 0.2 s count: they are fresh, and what they ask for lasts 0.3 s.
    return hand.last_sent_ns


def _back_from_slow(scene: Scene) -> None:
    hand = scene.hand
    wait_for(lambda: hand.gate.dropped.get("stale", 0) > 0, "a stale command")
    wait_for(lambda: not hand.gate.lease, "the lease to lapse")
    hand.silent = True
    scene.rig.link.release()


def _says(payload: bytes) -> Mishap:
    def act(scene: Scene) -> None:
        scene.hand.payload = payload

    return Mishap(act, drivers=(HAND,))


def _clock_back(scene: Scene) -> None:
    scene.hand.age_s = 3600.0


def _foreign_goes_on(scene: Scene) -> int:
    """Two ask for different things; then the one who may falls silent."""
    rig = scene.rig
    stranger = rig.hand()
    stranger.greedy, stranger.velocity = False, Velocity(-0.3, 0.6)
    began_ns = time.monotonic_ns()
    time.sleep(0.5)
    if any(row.omega != 0.0 or abs(row.v - SPEED_M_S) > 0.02 for row in rig.truth.since(began_ns)):
        raise Unsafe("a foreign publisher moved the rover")
    silent_ns = time.monotonic_ns()
    scene.hand.silent = True
    time.sleep(1.0)
    rig.leave(stranger)
    return silent_ns


def _flood(scene: Scene) -> int:
    stranger = scene.rig.hand()
    stranger.greedy, stranger.silent = False, True
    payload, sent, began = twist_stamped(Velocity(0.3, 0.0), 0), 0, time.monotonic()
    silent_ns = time.monotonic_ns()
    scene.hand.silent = True
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
    scene.hand.silent = True


def _with_outlet_blocked(mishap: Mishap) -> Mishap:
    """Return a fault of which the bridge would like to say something and cannot."""

    def act(scene: Scene) -> int | None:
        assert scene.rig.bridge.outlet is not None  # or the row names none
        scene.rig.bridge.outlet.block()
        return mishap.act(scene)

    return mishap._replace(act=act, drivers=(HAND,))


_GOOD = twist_stamped(Velocity(0.2, 0.0), 0)

_WITHOUT_OUTLET: Mapping[str, Mishap] = {
    "odometry-frozen": _base("freeze-odometry@0-3", "odometry-frozen"),
    "odometry-jumps": _base("jump-odometry@0-3", drivers=(CIRCUIT,)),
    "odometry-nan": Mishap(_strange_odometry, drivers=(CIRCUIT,)),
    "mute": _base("mute@0-2", "no-base"),
    "bumper": _base("bumper@0-1.5", "bumper"),
    "stall": _base("stall@0-1.5", "stall"),
    "stop-button": _base("stop-button@0-1.5", "stop-button"),
    "low-battery": _base("low-battery=10@0-4", "low-battery"),
    "restart": _base("reset@0-0.05", "no-base", greedy=False),
    "line-reset": Mishap(lambda scene: scene.rig.line.reset().t_ns, ended="no-base", greedy=False),
    "line-pulled": Mishap(
        lambda scene: scene.rig.line.hold_both_ways().t_ns,
        lambda scene: _release(scene.rig.line),
        ended="no-base",
    ),
    "deploy-killed": Mishap(_signalled(signal.SIGKILL), drivers=(CIRCUIT,)),
    "deploy-stopped": Mishap(
        _signalled(signal.SIGSTOP), _signalled(signal.SIGCONT), drivers=(CIRCUIT,), losing=True
    ),
    "deploy-hung": Mishap(
        lambda scene: _hung(scene.process), _signalled(signal.SIGKILL), drivers=(CIRCUIT,), losing=True
    ),
    "deploy-held": Mishap(
        lambda scene: scene.rig.link.hold().t_ns,
        _release_without_lease,
        drivers=(CIRCUIT,),
        spoilt=True,
        losing=True,
    ),
    "link-late": Mishap(
        _deliver_late, _all_arrive, drivers=(HAND,), spoilt=True, lease_s=LONG_LEASE_S, ended="lease-lapsed"
    ),
    "link-cut": Mishap(
        lambda scene: scene.rig.link.cut().t_ns,
        lambda scene: _release(scene.rig.link),
        spoilt=True,
        losing=True,
    ),
    "link-slow": Mishap(
        # It sends nothing but commands: a request for the motors that comes late makes late ones look fresh.
        lambda scene: scene.rig.link.throttle(1000).t_ns,
        _back_from_slow,
        drivers=(HAND,),
        spoilt=True,
        greedy=False,
    ),
    "link-held-first": Mishap(
        _held_before_the_first, drivers=(HAND,), spoilt=True, lease_s=LONG_LEASE_S, from_rest=True
    ),
    "not-a-number": _says(twist_stamped(Velocity(math.nan, 0.0), 0)),
    "infinite": _says(twist_stamped(Velocity(0.1, -math.inf), 0)),
    "truncated": _says(_GOOD[:-5]),
    "oversized": _says(_GOOD + bytes(500_000)),
    "another-type": _says(odometry(Pose(0.2, 0.2, 0.2), Velocity(0.2, 0.2), 0)),
    "no-type": _says(text("forward!")),
    "clock-back": Mishap(_clock_back, drivers=(HAND,)),
    "foreign": Mishap(_foreign_goes_on, drivers=(HAND,)),
    "flood": Mishap(_flood, drivers=(HAND,)),
    "bridge-stopped": Mishap(_bridge_signalled(signal.SIGSTOP), _bridge_resumes, losing=True),
    "bridge-hung": Mishap(lambda scene: _hung(scene.rig.bridge), _bridge_wakes, losing=True),
    "bridge-killed": Mishap(
        _bridge_signalled(signal.SIGKILL), lambda scene: scene.rig.start_bridge(), losing=True
    ),
}
_WITH_OUTLET: Mapping[str, Mishap] = {
    **{key: _WITHOUT_OUTLET[key] for key in ("bumper", "stall", "stop-button")},
    "stop-query": Mishap(_stop_asked, _stop_released, ended="stopped"),
    "silence": Mishap(_silent, ended="lease-lapsed", greedy=False),
}

MISHAPS: Mapping[str, Mishap] = {
    **_WITHOUT_OUTLET,
    **{
        f"{outlet}-{key}": _with_outlet_blocked(mishap)
        for outlet in OUTLETS
        for key, mishap in _WITH_OUTLET.items()
    },
}
"""By the key of the matrix's row."""
