"""Measure one row of the safety matrix: start a driver, inject the fault, time the rover's standstill.

Fault and standstill are timed on one clock, the machine's monotonic clock:

- The mock keeps its simulation at that clock and stamps every step with it. A fault of the base begins at the
  stamp of a step.
- Links and the hang wrapper stamp a fault just before it takes effect. Signals and the scripted driver's
  messages are stamped here, just before they are sent. Such a fault never looks younger than it is.
- Simulated time is real time, as in the requirement. When the machine keeps the mock or the line to it from
  running, the bridge's bytes lie in a buffer, and the base receives them later than a real one would. That
  delay belongs to the measurement, not to the bridge. Mock and line report the longest, and it is part of the
  resolution. The same holds for what reaches the base after its bridge was killed: it was on its way, through
  threads of Zenoh whose delays nothing else shows.
- A resolution worse than `MAX_LATE_S` could hide a late stop. Such a measurement is repeated, and never
  counts as in time.
"""

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from kit.true_motion import SAMPLE_S, states_since

from faults.rig import Rig, Scene, Unsafe
from faults.row import CIRCUIT, Row, braking_s
from faults.scripted_driver import ScriptedDriver
from sim.park.live import TimedOut, wait_for

ROWS_FILE = os.environ.get("ROVER_NCP_SAFETY_ROWS")
"""Set by tests/tools/safety_table.py, which writes all rows into the page."""
MAX_LATE_S = 0.1
"""The longest delay of mock and line in a measurement that counts."""
TRIES = 5
DEPLOY_TIMEOUT_S = 20.0
STOPPED = 4
"""Exit code of a deploy that a safety rule stopped."""


class Measured(NamedTuple):
    """A measured stop: times in s, and ``began_ns`` since the epoch.

    The rover has to stand within ``bound_s`` and ``braking_s``, from its greatest speeds since the fault.
    ``seconds`` may be too long by one sample and by ``late_s``, the longest time for which the machine kept
    mock and line from running, or commands on their way.
    """

    row: Row
    began_ns: int
    seconds: float
    bound_s: float
    braking_s: float
    late_s: float
    stopped_by: str = ""
    """The reason for the driver's stop, as the driver or the gate reported it."""
    note: str = ""

    @property
    def in_time(self) -> bool:
        """Whether the rover stood in time, by the shortest time consistent with the measurement.

        A measurement with a ``late_s`` above `MAX_LATE_S` is never in time.
        """
        allowed_s = self.bound_s + self.braking_s + SAMPLE_S + self.late_s
        return self.late_s <= MAX_LATE_S and self.seconds <= allowed_s


def time_stop(rig: Rig, row: Row, act: Callable[[], int | None]) -> Measured:
    """Cause a fault, and time the rover's stop from then. ``act`` returns what a row's act returns."""
    rig.late_s()
    called_ns = time.monotonic_ns()
    began_ns = act() or called_ns
    seconds = rig.stood(began_ns)
    late_s = rig.late_s()
    if row.silences:
        late_s = max(late_s, rig.heard_after_s(began_ns))
    states, bound_s = states_since(rig.truth, began_ns), row.bound_s(rig.description)
    velocities = [s.velocity for s in states if s.clock_ns <= began_ns + bound_s * 1e9]
    v, omega = np.abs(velocities).max(axis=0).tolist()
    return Measured(row, states[0].wall_ns, seconds, bound_s, braking_s(rig.description, v, omega), late_s)


def require_in_time(measured: Measured, form: str = "") -> None:
    """Save a measured row for the page if it is being written, and assert that the rover stood in time."""
    found = measured._asdict() | {"row": measured.row.key, "form": form}
    if ROWS_FILE:
        with Path(ROWS_FILE).open("a") as file:
            file.write(json.dumps(found) + "\n")
    assert measured.in_time, found


def measure(rig: Rig, row: Row, driver: str) -> Measured:
    """Measure a row under ``driver``.

    A measurement whose resolution is too bad is repeated. Raises TimedOut when every try was too bad, Unsafe
    when the rover moves after the fault was removed, and the errors of `Rig`.
    """
    for _ in range(TRIES):
        scene = _start_driver(rig, row, driver)
        try:
            measured = _measure(scene, row, driver)
        finally:
            rig.end(scene.driver)
        if measured.late_s <= MAX_LATE_S:
            return measured
    raise TimedOut(
        f"the machine kept mock or line from running for more than {MAX_LATE_S} s in each of {TRIES} "
        "measurements; repeat on a machine with less load"
    )


def _start_driver(rig: Rig, row: Row, driver: str) -> Scene:
    robot = rig.through_proxy if row.layer == "link" else rig.robot
    if driver == CIRCUIT:
        return Scene(rig, rig.drive_course(robot=robot))
    return Scene(rig, rig.scripted_driver(robot, row.lease_s))


def _measure(scene: Scene, row: Row, driver: str) -> Measured:
    rig, act = scene.rig, row.act
    assert act is not None  # the caller chose a row that can be injected
    if driver == CIRCUIT:
        rig.driven(scene.process)
    elif row.from_rest:
        scene.scripted.silent = True
    else:
        rig.under_way(scene.scripted)
    if driver != CIRCUIT:
        scene.scripted.requests_lease = row.requests_lease
    measured = time_stop(rig, row, lambda: act(scene))
    scene.request_no_lease()
    if row.ended and driver != CIRCUIT:
        wait_for(lambda: rig.watcher.gate.ended == row.ended, what=f"the gate to report {row.ended}")
    mended_ns = time.monotonic_ns()
    row.mend(scene)
    stopped_by = _stopped_by(scene)
    if rig.stood(mended_ns) > 0.0:
        raise Unsafe("the rover moved again after the fault was removed")
    return measured._replace(stopped_by=stopped_by, note=scene.note)


def _stopped_by(scene: Scene) -> str:
    """Return the reason for the driver's stop; a circuit must report one, unless it was killed."""
    if isinstance(scene.driver, ScriptedDriver):
        return scene.rig.watcher.gate.ended
    done = scene.driver.wait(DEPLOY_TIMEOUT_S)
    if done.code < 0:
        return "killed"
    if done.code != STOPPED:
        raise Unsafe(f"deploy ended with {done.code}, not {STOPPED}: {done.last_line}")
    return str(done.result.get("stopped_by"))
