"""The Python API of policies, courses and recordings; training and evaluation are in ``sim.api``.

    from rover_ncp import api

    driver = api.CourseDriver(api.load_policy("course"), api.load_course("parking"))
    v, omega = driver.tick(x, y, theta)        # every 0.1 s

What needs numba (running a policy) loads it when it is used. Errors are those of ``rover_ncp.core.errors``.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy, save_policy
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.core.errors import RoverNcpError
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.course.course import TICK_S, Course, load_course
from rover_ncp.course.reference import plan_reference

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from rover_ncp.circuit.runner import Runner

__all__ = [
    "Course",
    "CourseDriver",
    "Policy",
    "Pose",
    "RoverNcpError",
    "Runner",
    "Velocity",
    "load_course",
    "load_policy",
    "read_arrays",
    "save_policy",
]


def __getattr__(name: str) -> Any:
    if name == "Runner":
        from rover_ncp.circuit.runner import Runner

        return Runner
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def read_arrays(path: str | Path) -> "dict[str, NDArray[np.void]]":
    """Return a recording's topics as structured arrays: ``arrays["odom"]["x"]`` has shape (n,), in m.

    See ``rover_ncp/recording/arrays.py`` for the fields. Raises FileError.
    """
    from rover_ncp.recording.arrays import read_arrays as read

    return read(Path(path))


class CourseDriver:
    """A policy that drives a course, tick by tick; it begins at rest.

    Raises ConfigError for a policy that does not drive a rover.
    """

    def __init__(self, policy: Policy, course: Course) -> None:
        from rover_ncp.circuit.runner import Runner

        self._interface = RoverInterface(policy)
        self.course = course
        self.runner = Runner(policy)
        self.index = 0
        """The next tick of the course, from 0."""
        self._reference = plan_reference(course) if self._interface.needs_reference else None
        self._started = False

    def reset(self) -> None:
        """Put every neuron at rest, at the course's start."""
        self.runner.reset()
        self.index, self._started = 0, False

    def tick(self, x: float, y: float, theta: float) -> Velocity:
        """Return the command v, ω in m/s and rad/s for the base's pose in the course's frame in m and rad.

        Call it every 0.1 s, ``course.ticks`` times. The first call also runs the warm-up tick, in which the
        circuit sees the start pose before the start signal.
        """
        if not self._started:
            self.runner.tick(self._observation(Pose(x, y, theta), 0.0))
            self._started = True
        start = self.course.start_signal(self.index * TICK_S)
        command = self.runner.tick(self._observation(Pose(x, y, theta), start))
        self.index += 1
        return Velocity(*command)

    def _observation(self, pose: Pose, start: float) -> list[float]:
        reference = self._reference.tick(self.index) if self._reference else None
        return self._interface.observe(pose, start, reference)
