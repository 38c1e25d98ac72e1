"""One row of the safety matrix, measured: let somebody drive, bring the mishap about, see the rover stand.

Fault and standstill are timed on one clock, the machine's monotonic clock:

- The mock keeps its simulation at that clock and stamps every step with it. A fault of the base begins at the
  stamp of a step.
- Links and the wrapper that hangs stamp a fault just before it takes effect; signals and what the scripted
  driver sends are stamped here, just before. Such a fault never looks younger than it is.
- Simulated time is real time, as the requirement is. When the machine keeps the mock or the line to it from
  running, what the bridge sent lies in a buffer, and the base receives it later than a real one would. That
  delay is the measurement's, not the bridge's. Both report the longest, and it is part of the resolution.
- A resolution worse than `MOST_LATE_S` could hide a stop that is late. Such a measurement is repeated, and
  none that is so bad is ever in time.
"""

import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sim.faults.faults import CIRCUIT, MISHAPS, Mishap, Scene
from sim.faults.rig import CREEP_M_S, InVain, Rig, Unsafe, wait_for
from sim.faults.scripted_driver import Hand
from sim.faults.standstill import SAMPLE_S
from sim.faults.table import Row, braking_s

MOST_LATE_S = 0.1
"""The longest delay of mock and line in a measurement that counts."""
TRIES = 5
STAND_TIMEOUT_S = 8.0
DEPLOY_TIMEOUT_S = 20.0
STOPPED = 4
"""What a deploy ends with that a safety rule stopped."""
CIRCUIT_WAIT_S, HAND_WAIT_S = 4.0, 1.0
"""How long the rover may be under way before it happens."""


class Measured(NamedTuple):
    """How a row went: times in s, ``began_ns`` since the epoch; ``v`` and ``omega`` are the fastest since.

    ``seconds`` may be too long by ``late_s``, the longest that the machine kept mock and line from running,
    and by a sample.
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
    """What stopped the driver, by its own words or the gate's."""

    @property
    def braking_s(self) -> float:
        """What braking from that speed takes."""
        return braking_s(self.v, self.omega)

    @property
    def in_time(self) -> bool:
        """Whether the rover stood as soon as it has to, by the shortest time that fits the measurement."""
        return in_time(self.row, self.seconds, self.braking_s, self.late_s)


def in_time(row: Row, seconds: float, braking_s: float, late_s: float) -> bool:
    """Whether a measured time fits the requirement: the row's bound, braking, and the resolution.

    The resolution is one sample, in which the rover came to stand, and ``late_s`` (see `Measured`). A time
    with a ``late_s`` above `MOST_LATE_S` fits no requirement.
    """
    return late_s <= MOST_LATE_S and seconds <= row.bound_s + braking_s + SAMPLE_S + late_s


def measure(
    rig: Rig, row: Row, driver: str, record: Path | None = None, chance: np.random.Generator | None = None
) -> Measured:
    """Measure a row under ``driver``, a circuit's drive recorded to ``record``; ``chance`` picks the moment.

    Repeats a measurement whose resolution is too bad. Raises InVain when all are, Unsafe when the rover moves
    once all is mended, and what `Rig` raises.
    """
    for _ in range(TRIES):
        measured = _measure(rig, row, driver, record, chance)
        if measured.late_s <= MOST_LATE_S:
            return measured
        if record is not None:
            record.unlink(missing_ok=True)
    raise InVain(
        f"the machine kept mock or line from running for more than {MOST_LATE_S} s in each of {TRIES} "
        "measurements: measure on a machine that does less beside"
    )


def _measure(
    rig: Rig, row: Row, driver: str, record: Path | None, chance: np.random.Generator | None
) -> Measured:
    mishap = MISHAPS[row.key]
    robot = rig.spoilt if mishap.spoilt else rig.robot
    scene = _under_circuit(rig, robot, record) if driver == CIRCUIT else _under_hand(rig, robot, mishap)
    try:
        if chance is not None and not mishap.from_rest:
            time.sleep(chance.uniform(0.0, CIRCUIT_WAIT_S if driver == CIRCUIT else HAND_WAIT_S))
            wait_for(lambda: abs(rig.speed()) > CREEP_M_S, "the rover under way")
        if isinstance(scene.driver, Hand):
            scene.driver.greedy = mishap.greedy
        rig.late_s()
        called_ns = time.monotonic_ns()
        began_ns = mishap.act(scene) or called_ns
        seconds = rig.stood(began_ns, STAND_TIMEOUT_S)
        late_s = rig.late_s()
        v, omega = _fastest(rig, began_ns, row.bound_s)
        if isinstance(scene.driver, Hand):
            scene.driver.greedy = False
            if mishap.ended:
                wait_for(lambda: rig.watcher.gate.ended == mishap.ended, f"the gate to say {mishap.ended}")
        mended_ns = time.monotonic_ns()
        mishap.mend(scene)
        ended = _ends(scene)
        if rig.stood(mended_ns, STAND_TIMEOUT_S) > 0.0:
            raise Unsafe("the rover moved again when all was mended")
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


def _under_hand(rig: Rig, robot: str, mishap: Mishap) -> Scene:
    scene = Scene(rig, rig.hand(robot, mishap.lease_s))
    if mishap.from_rest:
        scene.hand.silent = True
    else:
        rig.under_way(scene.hand)
    return scene


def _fastest(rig: Rig, began_ns: int, within_s: float) -> tuple[float, float]:
    rows = [row for row in rig.truth.since(began_ns) if row.clock_ns <= began_ns + within_s * 1e9]
    return max((abs(row.v) for row in rows), default=0.0), max((abs(row.omega) for row in rows), default=0.0)


def _ends(scene: Scene) -> str:
    """Return what stopped the driver; a circuit has to have noticed, unless it was killed."""
    if isinstance(scene.driver, Hand):
        return scene.rig.watcher.gate.ended
    done = scene.driver.wait(DEPLOY_TIMEOUT_S)
    result: dict[str, Any] = done.result
    if done.code < 0:
        return "killed"
    if done.code != STOPPED:
        raise Unsafe(f"deploy ended with {done.code}, not {STOPPED}: {done.last_line}")
    return str(result.get("stopped_by"))


def _leave(scene: Scene) -> None:
    if isinstance(scene.driver, Hand):
        scene.rig.leave(scene.driver)
    else:
        scene.rig.ended(scene.driver)
