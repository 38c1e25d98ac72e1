"""The Python API of policies, courses and recordings; training and evaluation are in ``sim.api``.

    from rover_ncp import api

    runner = api.Runner(api.load_policy("parking"))
    v, omega = runner.tick([x, y, theta, start])        # every 0.1 s

What needs numba (running a policy) loads it when it is used. Errors are those of ``rover_ncp.core.errors``.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy, save_policy
from rover_ncp.core.errors import RoverNcpError
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.course.course import Course, load_course

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from rover_ncp.circuit.runner import Runner

__all__ = [
    "Course",
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
