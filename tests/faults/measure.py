"""Measure one row of the safety matrix: start a driver, inject the fault, time the rover's standstill.

Fault and standstill are timed on one clock, the machine's monotonic clock:

- The mock keeps its simulation at that clock and stamps every step with it. A fault of the base begins at the
  stamp of a step.
- Links and the hang wrapper stamp a fault just before it takes effect. Signals and the scripted driver's
  messages are stamped here, just before they are sent. Such a fault never looks younger than it is.
- Simulated time is real time, as in the requirement. When the machine keeps the mock or the line to it from
  running, the bridge's bytes lie in a buffer, and the base receives them later than a real one would. That
  delay belongs to the measurement, not to the bridge. Mock and line report the longest, and it is part of the
  resolution.
- A resolution worse than `MAX_LATE_S` could hide a late stop. Such a measurement is repeated, and never
  counts as in time.
"""

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from faults.rig import CREEP_M_S, Rig, Scene, Unsafe
from faults.row import CIRCUIT, Row, braking_s
from faults.scripted_driver import ScriptedDriver
from sim.live.processes import TimedOut, wait_for
from sim.live.truth import SAMPLE_S

MAX_LATE_S = 0.1
"""The longest delay of mock and line in a measurement that counts."""
TRIES = 5
DEPLOY_TIMEOUT_S = 20.0
STOPPED = 4
"""Exit code of a deploy that a safety rule stopped."""
CIRCUIT_WAIT_S, SCRIPTED_WAIT_S = 4.0, 1.0
"""The longest time that the rover moves before the fault."""


class Measured(NamedTuple):
    """Result of a row: times in s, ``began_ns`` since the epoch; ``v`` and ``omega`` are the fastest since.

    ``seconds`` may be too long by one sample and by ``late_s``, the longest time for which the machine kept
    mock and line from running.
    """

    row: Row
    driver: str
    began_ns: int
    seconds: float
    late_s: float
    v: float
    omega: float
    note: str
    stopped_by: str
    """The reason for the driver's stop, as the driver or the gate reported it."""

    @property
    def braking_s(self) -> float:
        """The time in s for braking from that speed."""
        return braking_s(self.v, self.omega)

    @property
    def in_time(self) -> bool:
        """Whether the rover stood in time, by the shortest time consistent with the measurement."""
        return in_time(self.row, self.seconds, self.braking_s, self.late_s)


def in_time(row: Row, seconds: float, braking_s: float, late_s: float) -> bool:
    """Whether a measured time fits the requirement: the row's bound, braking, and the resolution.

    The resolution is one sample, in which the rover stopped, and ``late_s`` (see `Measured`). A time
    with a ``late_s`` above `MAX_LATE_S` fits no requirement.
    """
    return late_s <= MAX_LATE_S and seconds <= row.bound_s + braking_s + SAMPLE_S + late_s


def measure(
    rig: Rig, row: Row, driver: str, record: Path | None = None, moments: np.random.Generator | None = None
) -> Measured:
    """Measure a row under ``driver``, a circuit's drive recorded to ``record``; ``moments`` picks the moment.

    A measurement whose resolution is too bad is repeated. Raises TimedOut when every try was too bad, Unsafe
    when the rover moves after the fault was removed, and the errors of `Rig`.
    """
    for _ in range(TRIES):
        scene = _start_driver(rig, row, driver, record)
        try:
            measured = _measure(scene, row, driver, moments)
        finally:
            rig.end(scene.driver)
        if measured.late_s <= MAX_LATE_S:
            return measured
        if record is not None:
            record.unlink(missing_ok=True)
    raise TimedOut(
        f"the machine kept mock or line from running for more than {MAX_LATE_S} s in each of {TRIES} "
        "measurements; repeat on a machine with less load"
    )


def _start_driver(rig: Rig, row: Row, driver: str, record: Path | None) -> Scene:
    robot = rig.through_proxy if row.link_fault else rig.robot
    if driver == CIRCUIT:
        return Scene(rig, rig.drive_course(*(["--record", str(record)] if record else []), robot=robot))
    return Scene(rig, rig.scripted_driver(robot, row.lease_s))


def _measure(scene: Scene, row: Row, driver: str, moments: np.random.Generator | None) -> Measured:
    assert row.act is not None  # the caller chose a row that can be injected
    rig = scene.rig
    if driver == CIRCUIT:
        rig.driven(scene.process)
    elif row.from_rest:
        scene.scripted.silent = True
    else:
        rig.under_way(scene.scripted)
    if moments is not None and not row.from_rest:
        time.sleep(moments.uniform(0.0, CIRCUIT_WAIT_S if driver == CIRCUIT else SCRIPTED_WAIT_S))
        wait_for(lambda: abs(rig.truth.speed()) > CREEP_M_S, what="the rover to move")
    if driver != CIRCUIT:
        scene.scripted.requests_lease = row.requests_lease
    rig.late_s()
    called_ns = time.monotonic_ns()
    began_ns = row.act(scene) or called_ns
    seconds = rig.stood(began_ns)
    late_s = rig.late_s()
    states = rig.truth.since(began_ns)
    velocities = [s.velocity for s in states if s.clock_ns <= began_ns + row.bound_s * 1e9]
    scene.request_no_lease()
    if row.ended and driver != CIRCUIT:
        wait_for(lambda: rig.watcher.gate.ended == row.ended, what=f"the gate to report {row.ended}")
    mended_ns = time.monotonic_ns()
    row.mend(scene)
    stopped_by = _stopped_by(scene)
    if rig.stood(mended_ns) > 0.0:
        raise Unsafe("the rover moved again after the fault was removed")
    return Measured(
        row,
        driver,
        states[0].wall_ns,
        seconds,
        late_s,
        max((abs(v) for v, _ in velocities), default=0.0),
        max((abs(omega) for _, omega in velocities), default=0.0),
        scene.note,
        stopped_by,
    )


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
