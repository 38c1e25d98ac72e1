"""A row of the safety matrix: a fault, how it is injected, and how soon the rover must stand."""

import math
from collections.abc import Callable
from typing import NamedTuple

from faults.rig import Scene
from faults.scripted_driver import NAME
from rover_ncp.robot.description import RobotDescription
from sim.base.ros2_robot import BATTERY_S

STOP_S, WATCHDOG_S = 0.5, 2.0
"""The first safety requirement, and a Pioneer's own watchdog."""
LOW_BATTERY_S = 2.0
"""How long the voltage must be low before it counts: it sags when the motors start."""
CIRCUIT, SCRIPTED = "circuit", NAME
"""The drivers."""


Act = Callable[[Scene], int | None]


class Row(NamedTuple):
    """A fault of a layer."""

    key: str
    layer: str
    fault: str
    act: Act | None = None
    """Injects the fault into running processes. Returns when it began, in ns of the monotonic clock, or None
    for the time of its call."""
    mend: Callable[[Scene], object] = lambda scene: None
    """Removes the fault; by default it ends by itself."""
    ended: str = ""
    """The reason for which the gate ends the lease, if it always does."""
    only: str = ""
    """The only driver under which the fault can be injected, if not both."""
    requests_lease: bool = True
    """Whether a scripted driver requests the lease again. False where the gate would grant it at once."""
    lease_s: float = 1.0
    """Zenoh lease of a scripted driver."""
    from_rest: bool = False
    """Whether the rover stands when the fault begins."""
    outlet: str = ""
    """The kind of `Outlet` that takes the bridge's output, which stops just before the fault."""

    @property
    def drivers(self) -> tuple[str, ...]:
        """The drivers under which the fault can be injected."""
        return (self.only,) if self.only else (SCRIPTED, CIRCUIT)

    @property
    def silences(self) -> bool:
        """Whether the base hears nothing more: what it receives after the fault was on its way before."""
        return self.layer == "bridge"

    def bound_s(self, robot: RobotDescription) -> float:
        """Return the time in s, plus braking, within which the robot stands."""
        if self.layer in {"line", "bridge"}:
            return WATCHDOG_S if robot.topics is None else robot.topics.cmd_vel_timeout_s or math.inf
        if self.key == "low-battery":
            # The bridge gets a ROS 2 robot's voltage with the next report of its battery.
            return STOP_S + LOW_BATTERY_S + (BATTERY_S if robot.topics else 0.0)
        return STOP_S


def braking_s(robot: RobotDescription, v: float, omega: float = 0.0) -> float:
    """Return how long a robot takes to stand, in s, from a speed in m/s and a turn rate in rad/s."""
    motion, delays = robot.motion, robot.delays
    return max(delays.v_s, delays.omega_s) + max(abs(v) / motion.decel, abs(omega) / motion.alpha_decel)
