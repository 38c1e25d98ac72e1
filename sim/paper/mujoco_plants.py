"""MuJoCo's plants for the kernels: models loaded with Gymnasium's files, functions found by their address.

From Python a step of the inverted pendulum costs more in calls than in physics, and all lanes' circuits would
wait for it one by one. ``mj_step`` is plain C, so a kernel calls it directly.

The caller of a kernel on these lanes must keep the ``MujocoPool`` alive: it owns the memory.
"""

import ctypes
from functools import cache
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.errors import RoverNcpError
from sim.paper.plants import MujocoLanes

# Without a handler, MuJoCo writes a warning, such as that of an outdated attribute in Gymnasium's
# half-cheetah, to a file in the current folder. Other warnings report an unstable simulation, which shows in
# its return too.
mujoco.set_mju_user_warning(lambda _: None)


def model_file(name: str) -> Path:
    """Return one of the models that Gymnasium's environments load."""
    return Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets" / name


@cache
def _library() -> ctypes.CDLL:
    """Return the library that the bindings have loaded already."""
    [path] = Path(mujoco.__file__).parent.glob("libmujoco.*")
    return ctypes.CDLL(str(path))


def _address(name: str) -> int:
    found = ctypes.cast(getattr(_library(), name), ctypes.c_void_p).value
    if found is None:
        raise RoverNcpError(f"mujoco {mujoco.__version__} has no {name}: install that of constraints.txt")
    return found


class MujocoPool:
    """One model, and data for so many lanes."""

    def __init__(self, file: str, frames: int, count: int, step_s: float | None = None) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(model_file(file)))
        if step_s is not None:
            self.model.opt.timestep = step_s
        self.data = [mujoco.MjData(self.model) for _ in range(count)]
        self.lanes = MujocoLanes(
            step=_address("mj_step"),
            reset=_address("mj_resetData"),
            forward=_address("mj_forward"),
            model=self.model._address,
            frames=frames,
            dt_s=self.model.opt.timestep * frames,
            positions=self.model.nq,
            velocities=self.model.nv,
            controls=self.model.nu,
            data=np.array([data._address for data in self.data], np.int64),
            qpos=_places([data.qpos for data in self.data]),
            qvel=_places([data.qvel for data in self.data]),
            ctrl=_places([data.ctrl for data in self.data]),
        )


def _places(arrays: list[NDArray[np.float64]]) -> NDArray[np.int64]:
    return np.array([array.ctypes.data for array in arrays], np.int64)
