"""Faults that must not end a drive, and faults of a base or a `check` that only some robots have.

The first go on until something else stops the rover: what stops it has to work as before.
"""

import time
from collections.abc import Callable
from signal import SIGKILL, SIGTERM
from typing import Any

from kit.true_motion import speed

from faults.hang import CLOCK_STEPS_S, SILENT_CLOSE
from faults.rig import CREEP_M_S, Scene, Unsafe
from faults.row import CIRCUIT, SCRIPTED, Act, Row
from sim.park.live import Process

GOES_ON_S = 1.0
BEHIND_S = 3
"""How long a robot's clock is behind."""
LARGEST_STEP_S = 1.0
"""A larger step of a ROS 2 robot's clock counts as its restart."""


def silence(scene: Scene) -> None:
    """Let a scripted driver send no more commands."""
    scene.scripted.silent = True


def _goes_on(fault: Callable[[Scene], object], end: Callable[[Scene], object]) -> Act:
    """Return a fault after which the rover must drive on for `GOES_ON_S`, until ``end``."""

    def act(scene: Scene) -> int:
        fault(scene)
        time.sleep(GOES_ON_S)
        if abs(speed(scene.rig.truth)) < CREEP_M_S:
            raise Unsafe("the rover stands after a fault that must not end its drive")
        ended_ns = time.monotonic_ns()
        end(scene)
        return ended_ns

    return act


def _step_clock(process: Process, number: int) -> None:
    process.answer_to(lambda: process.send_signal(number))


def _end_with_silent_close(scene: Scene) -> int:
    bridge = scene.rig.bridge
    bridge.answer_to(lambda: bridge.send_signal(SILENT_CLOSE))
    ended_ns = time.monotonic_ns()
    bridge.send_signal(SIGTERM)
    return ended_ns


def _robot_clock(step_s: float) -> Row:
    """A step of the clock that stamps a ROS 2 robot's odometry; a large one is a restart of the robot."""
    key, fault = f"robot-clock-{step_s:g}", f"clock=-{step_s:g}@0-{BEHIND_S}"
    # The next fault must not find a clock that is about to step forward.
    more: dict[str, Any] = {"only": SCRIPTED, "requests_lease": False, "mend": lambda _: time.sleep(BEHIND_S)}
    if step_s > LARGEST_STEP_S:
        words = f"its clock steps back by {step_s:g} s, which counts as a restart"
        return Row(key, "base", words, lambda scene: scene.rig.mock.tell(fault).t_ns, ended="no-base", **more)
    words = f"its clock steps back by {step_s:g} s, then no more commands"
    act = _goes_on(lambda scene: scene.rig.mock.tell(fault), silence)
    return Row(key, "base", words, act, ended="lease-lapsed", **more)


def start_bridge(scene: Scene) -> None:
    """Start a bridge in place of one that ended."""
    scene.rig.start_bridge()


SILENT_CLOSE_ROW = Row(
    "silent-close",
    "base",
    "`close` of its driver sends nothing, and the bridge ends",
    _end_with_silent_close,
    start_bridge,
    only=SCRIPTED,
)
# The tests of rows without an act are their own: they need limits, a gyro, a localiser or a check.
OWN_ROWS = (
    Row("fence-lost", "base", "restarts, with a fence: no lease until the bridge is restarted"),
    Row("gyro-standing", "base", "its gyro reads 2 rad/s for 0.1 s while it stands, then deploy ends"),
    Row("gyro-moving", "base", "its gyro reads 2 rad/s for 0.1 s while it drives, then deploy ends"),
)


def _clock_rows(
    key: str, clock: str, then: str, act: Callable[[int], Act] | None = None, **more: Any
) -> tuple[Row, ...]:
    """Return one row for each step of a clock."""
    return tuple(
        Row(
            f"{key}-clock-{step_s:g}",
            "clock",
            f"{clock} steps back by {step_s:g} s, then {then}",
            act and act(number),
            **more,
        )
        for number, step_s in CLOCK_STEPS_S.items()
    )


CLOCK_ROWS = (
    *_clock_rows(
        "bridge",
        "the bridge's",
        "no more commands",
        lambda number: _goes_on(lambda scene: _step_clock(scene.rig.bridge, number), silence),
        only=SCRIPTED,
        ended="lease-lapsed",
        requests_lease=False,
    ),
    *_clock_rows(
        "deploy",
        "deploy's",
        "it is killed",
        lambda number: _goes_on(
            lambda scene: _step_clock(scene.process, number),
            lambda scene: scene.process.send_signal(SIGKILL),
        ),
        only=CIRCUIT,
    ),
    *_clock_rows("localiser", "a localiser's", "deploy ends"),
)
ROS2_ROWS = tuple(map(_robot_clock, CLOCK_STEPS_S.values()))
"""Rows that only a ROS 2 robot has."""
