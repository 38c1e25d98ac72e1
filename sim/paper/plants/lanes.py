"""L plants of one kind, each lane in an episode of its own.

MuJoCo's step is called by its address (``mujoco.py``); the other plants are written out. The tests compare
each plant with its Gymnasium environment, step by step.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.kernels.jit import kernel
from sim.paper.plants.classic import step_cart_pole, step_mountain_car
from sim.paper.plants.pendulum import TILTED_RAD, step_pendulum
from sim.world.chipmunk import call_with_thing, load, store

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

KINDS = {"mountain-car": 0, "cart-pole": 1, "written-pendulum": 2, "pendulum": 3, "half-cheetah": 4}
"""A kernel compares numbers, not names."""
MOUNTAIN_CAR, CART_POLE, WRITTEN_PENDULUM, PENDULUM, HALF_CHEETAH = KINDS.values()

_CONTROL_COST = 0.1
"""gymnasium/envs/mujoco/half_cheetah_v5.py."""


class MujocoLanes(NamedTuple):
    """Addresses of MuJoCo's functions, its model, and each lane's data and arrays."""

    step: int
    reset: int
    forward: int
    model: int
    data: IntArray
    qpos: IntArray
    qvel: IntArray
    ctrl: IntArray
    """(L,) each."""


_NONE = np.zeros(0, np.int64)
NO_MUJOCO = MujocoLanes(0, 0, 0, 0, _NONE, _NONE, _NONE, _NONE)


class Plants(NamedTuple):
    """L plants of one kind."""

    kind: int
    bonus: float
    """Added to a pendulum's reward: bonus * (1 - |x|)."""
    step_s: float
    frames: int
    """Length of a physics step, and physics steps in a step of the environment."""
    state: FloatArray
    """(S, L), positions before velocities."""
    fresh: NDArray[np.bool_]
    """(L,) whether a plant has not moved yet."""
    mujoco: MujocoLanes


@kernel
def reset_plant(plants: Plants, lane: int, start: FloatArray) -> None:
    """Begin an episode at a state (S,)."""
    plants.fresh[lane] = True
    for i in range(len(start)):
        plants.state[i, lane] = start[i]
    if plants.kind in (PENDULUM, HALF_CHEETAH):
        mujoco, half = plants.mujoco, len(start) // 2
        call_with_thing(mujoco.reset, mujoco.model, mujoco.data[lane])
        for i in range(half):
            store(mujoco.qpos[lane] + 8 * i, start[i])
            store(mujoco.qvel[lane] + 8 * i, start[half + i])
        call_with_thing(mujoco.forward, mujoco.model, mujoco.data[lane])


@kernel
def observe(plants: Plants, lane: int, observations: FloatArray) -> None:
    """Write an agent's observation, in the order of the task's inputs, into its column of (inputs, L)."""
    state = plants.state
    if plants.kind == MOUNTAIN_CAR:
        observations[0, lane] = np.float32(state[0, lane])
        observations[1, lane] = np.float32(state[1, lane])
    elif plants.kind == CART_POLE:
        observations[0, lane] = np.float32(state[2, lane])
        observations[1, lane] = np.float32(state[3, lane])
    elif plants.kind == HALF_CHEETAH:
        for i in range(1, len(state)):
            observations[i - 1, lane] = state[i, lane]
    else:
        observations[0, lane] = state[1, lane]
        observations[1, lane] = state[0, lane]


@kernel
def step_plant(plants: Plants, lane: int, commands: FloatArray) -> tuple[float, float, bool]:
    """Advance one plant by the commands in its column of (outputs, L), which must be within their limits.

    Returns Gymnasium's reward, the bonus on top of it, and termination.
    """
    state = plants.state
    if plants.kind == MOUNTAIN_CAR:
        reward, terminated = step_mountain_car(state, plants.fresh, lane, commands[0, lane])
        return reward, 0.0, terminated
    if plants.kind == CART_POLE:
        return 1.0, 0.0, step_cart_pole(state, lane, commands[0, lane])
    before = state[0, lane]
    if plants.kind == WRITTEN_PENDULUM:
        terminated = step_pendulum(state, lane, plants.step_s, plants.frames, commands[0, lane])
    else:
        step_mujoco(plants, lane, commands)
        terminated = not abs(state[1, lane]) <= TILTED_RAD or not np.isfinite(state[0, lane])
    if plants.kind == HALF_CHEETAH:
        squares = 0.0
        for i in range(commands.shape[0]):
            squares += commands[i, lane] * commands[i, lane]
        speed = (state[0, lane] - before) / (plants.step_s * plants.frames)
        return speed - _CONTROL_COST * squares, 0.0, False
    if terminated:
        return 0.0, 0.0, True
    return 1.0, plants.bonus * (1.0 - abs(state[0, lane])), False


@kernel
def step_mujoco(plants: Plants, lane: int, commands: FloatArray) -> None:
    """Advance one of MuJoCo's plants, and read its state."""
    mujoco, state = plants.mujoco, plants.state
    for i in range(commands.shape[0]):
        store(mujoco.ctrl[lane] + 8 * i, commands[i, lane])
    for _ in range(plants.frames):
        call_with_thing(mujoco.step, mujoco.model, mujoco.data[lane])
    half = len(state) // 2
    for i in range(half):
        state[i, lane] = load(mujoco.qpos[lane] + 8 * i)
        state[half + i, lane] = load(mujoco.qvel[lane] + 8 * i)
