"""MuJoCo's model and data for a kernel, which calls ``mj_step``, a plain C function, by its address.

From Python a step of the inverted pendulum costs more in calls than in physics.
"""

import ctypes
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from paper.plants import MujocoLanes

# Without a handler, MuJoCo writes a warning, such as that of an outdated attribute in Gymnasium's
# half-cheetah, to a file in the current folder. Other warnings report an unstable simulation, which shows in
# its return too.
mujoco.set_mju_user_warning(lambda _: None)


def _address(name: str) -> int:
    """Return a function's address in the library that the bindings have loaded already."""
    [path] = Path(mujoco.__file__).parent.glob("libmujoco.*")
    found = ctypes.cast(getattr(ctypes.CDLL(str(path)), name), ctypes.c_void_p).value
    assert found is not None
    return found


class MujocoPool:
    """One of Gymnasium's models, and data for ``count`` lanes.

    Owns the memory behind ``lanes``: keep it alive while a kernel uses them.
    """

    def __init__(self, file: str, step_s: float, count: int) -> None:
        path = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets" / file
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.model.opt.timestep = step_s
        # Or an unstable simulation would begin again at rest, and its return would look like any other.
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = [mujoco.MjData(self.model) for _ in range(count)]
        self.lanes = MujocoLanes(
            step=_address("mj_step"),
            reset=_address("mj_resetData"),
            forward=_address("mj_forward"),
            model=self.model._address,
            data=np.array([data._address for data in self.data], np.int64),
            qpos=_addresses([data.qpos for data in self.data]),
            qvel=_addresses([data.qvel for data in self.data]),
            ctrl=_addresses([data.ctrl for data in self.data]),
        )


def _addresses(arrays: list[NDArray[np.float64]]) -> NDArray[np.int64]:
    return np.array([array.ctypes.data for array in arrays], np.int64)
