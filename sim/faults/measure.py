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
- A resolution worse than `MOST_LATE_S` could hide a late stop. Such a measurement is repeated, and never
  counts as in time.
"""

import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sim.faults.faults import CIRCUIT, FAULTS, Fault, Scene
from sim.faults.rig import CREEP_M_S, Rig, TimedOut, Unsafe, wait_for
from sim.faults.scripted_driver import ScriptedDriver
from sim.faults.standstill import SAMPLE_S
from sim.faults.table import Row, braking_s

MOST_LATE_S = 0.1
"""The longest delay of mock and line in a measurement that counts."""
TRIES = 5
STAND_TIMEOUT_S = 8.0
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
    with a ``late_s`` above `MOST_LATE_S` fits no requirement.
    """
    return late_s <= MOST_LATE_S and seconds <= row.bound_s + braking_s + SAMPLE_S + late_s


def measure(
    rig: Rig, row: Row, driver: str, record: Path | None = None, chance: np.random.Generator | None = None
) -> Measured:
    """Measure a row under ``driver``, a circuit's drive recorded to ``record``; ``chance`` picks the moment.

    A measurement whose resolution is too bad is repeated. Raises TimedOut when every try was too bad, Unsafe
    when the rover moves after the fault was removed, and the errors of `Rig`.
    """
    for _ in range(TRIES):
        measured = _measure(rig, row, driver, record, chance)
        if measured.late_s <= MOST_LATE_S:
            return measured
        if record is not None:
            record.unlink(missing_ok=True)
    raise TimedOut(
        f"the machine kept mock or line from running for more than {MOST_LATE_S} s in each of {TRIES} "
        "measurements; repeat on a machine with less load"
    )


def _measure(
    rig: Rig, row: Row, driver: str, record: Path | None, chance: np.random.Generator | None
) -> Measured:
    fault = FAULTS[row.key]
    robot = rig.through_proxy if fault.link_fault else rig.robot
    scene = (
        _under_circuit(rig, robot, record) if driver == CIRCUIT else _under_scripted_driver(rig, robot, fault)
    )
    try:
        if chance is not None and not fault.from_rest:
            time.sleep(chance.uniform(0.0, CIRCUIT_WAIT_S if driver == CIRCUIT else SCRIPTED_WAIT_S))
            wait_for(lambda: abs(rig.speed()) > CREEP_M_S, "the rover to move")
        if isinstance(scene.driver, ScriptedDriver):
            scene.driver.requests_lease = fault.requests_lease
        rig.late_s()
        called_ns = time.monotonic_ns()
        began_ns = fault.act(scene) or called_ns
        seconds = rig.stood(began_ns, STAND_TIMEOUT_S)
        late_s = rig.late_s()
        v, omega = _fastest(rig, began_ns, row.bound_s)
        if isinstance(scene.driver, ScriptedDriver):
            scene.driver.requests_lease = False
            if fault.ended:
                wait_for(lambda: rig.watcher.gate.ended == fault.ended, f"the gate to report {fault.ended}")
        mended_ns = time.monotonic_ns()
        fault.mend(scene)
        ended = _ends(scene)
        if rig.stood(mended_ns, STAND_TIMEOUT_S) > 0.0:
            raise Unsafe("the rover moved again after the fault was removed")
    except BaseException:
        _leave(scene)
        raise
    _leave(scene)
    began_wall_ns = rig.truth.since(began_ns)[0].wall_ns
    return Measured(row, driver, began_wall_ns, seconds, late_s, v, omega, scene.note, ended)


def _under_circuit(rig: Rig, robot: str, record: Path | None) -> Scene:
    scene = Scene(rig, rig.deploy(*(["--record", str(record)] if record else []), robot=robot))
    rig.driven(scene.process)
    return scene


def _under_scripted_driver(rig: Rig, robot: str, fault: Fault) -> Scene:
    scene = Scene(rig, rig.scripted_driver(robot, fault.lease_s))
    if fault.from_rest:
        scene.scripted.silent = True
    else:
        rig.under_way(scene.scripted)
    return scene


def _fastest(rig: Rig, began_ns: int, within_s: float) -> tuple[float, float]:
    rows = [row for row in rig.truth.since(began_ns) if row.clock_ns <= began_ns + within_s * 1e9]
    return max((abs(row.v) for row in rows), default=0.0), max((abs(row.omega) for row in rows), default=0.0)


def _ends(scene: Scene) -> str:
    """Return the reason for the driver's stop; a circuit must report one, unless it was killed."""
    if isinstance(scene.driver, ScriptedDriver):
        return scene.rig.watcher.gate.ended
    done = scene.driver.wait(DEPLOY_TIMEOUT_S)
    result: dict[str, Any] = done.result
    if done.code < 0:
        return "killed"
    if done.code != STOPPED:
        raise Unsafe(f"deploy ended with {done.code}, not {STOPPED}: {done.last_line}")
    return str(result.get("stopped_by"))


def _leave(scene: Scene) -> None:
    if isinstance(scene.driver, ScriptedDriver):
        scene.rig.leave(scene.driver)
    else:
        scene.rig.ended(scene.driver)
