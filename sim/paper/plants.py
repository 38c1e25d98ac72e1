"""The benchmarks' environments as lanes of a kernel: each lane a plant in its own episode.

Mountain car and cart-pole are written out here, operation by operation as Gymnasium has them; inverted
pendulum and half-cheetah are MuJoCo's, whose step is called by its address (``mujoco_plants.py``). These
two are written out as well (``pendulum.py``, ``cheetah.py``). The tests hold each to its Gymnasium
environment, step by step.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.kernels.jit import kernel
from sim.paper.cheetah import step_cheetah
from sim.paper.cheetah_model import COORDINATES, NO_CHEETAH, Cheetah, CheetahWork, cheetah_work
from sim.paper.pendulum import TILTED_RAD, step_pendulum
from sim.world.chipmunk import call_with_thing, load, store

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MOUNTAIN_CAR, CART_POLE, WRITTEN_PENDULUM, WRITTEN_CHEETAH, PENDULUM, CHEETAH = range(6)

# gymnasium/envs/classic_control/continuous_mountain_car.py
_POWER, _SLOPE = 0.0015, 0.0025
_MOST_SPEED, _LEFT_END, _RIGHT_END, _GOAL = 0.07, -1.2, 0.6, 0.45
_AT_GOAL = 100.0

# gymnasium/envs/classic_control/cartpole.py
_GRAVITY, _TAU_S, _HALF_POLE_M = 9.8, 0.02, 0.5
_POLE_KG, _TOTAL_KG = 0.1, 1.1
_POLE_KG_M = _POLE_KG * _HALF_POLE_M
_FORCE_N = 10.0
"""The force of a full action, that of the environment's two actions."""
_RAIL_M, _FALLEN_RAD = 2.4, 12 * 2 * math.pi / 360

# gymnasium/envs/mujoco/half_cheetah_v5.py
_EFFORT = 0.1


class MujocoLanes(NamedTuple):
    """MuJoCo's side of the lanes: addresses of its model, data and functions, 0 where there are none."""

    step: int
    reset: int
    forward: int
    model: int
    frames: int
    """Steps of MuJoCo in one of the environment."""
    dt_s: float
    positions: int
    velocities: int
    controls: int
    """How many."""
    data: IntArray
    qpos: IntArray
    qvel: IntArray
    ctrl: IntArray
    """(L,) each."""


class Plants(NamedTuple):
    """L plants of one kind."""

    kind: int
    bonus: float
    """Added to a pendulum's reward: bonus * (1 - |x|)."""
    state: FloatArray
    """(S, L) of what does without MuJoCo."""
    fresh: NDArray[np.bool_]
    """(L,) whether a plant has not moved yet."""
    mujoco: MujocoLanes
    step_s: float
    frames: int
    """A written plant's steps of so long in one of the environment."""
    cheetah: Cheetah
    cheetah_work: CheetahWork
    """One for all lanes, which are stepped one by one."""


_NONE = np.zeros(0, np.int64)
NO_MUJOCO = MujocoLanes(0, 0, 0, 0, 0, 1.0, 0, 0, 0, _NONE, _NONE, _NONE, _NONE)


def allocate_plants(
    kind: int,
    count: int,
    bonus: float = 0.0,
    mujoco: MujocoLanes = NO_MUJOCO,
    *,
    step_s: float = 0.0,
    frames: int = 1,
    cheetah: Cheetah = NO_CHEETAH,
) -> Plants:
    """Return plants, each to be set by ``reset_plant``."""
    state = np.zeros((2 * COORDINATES if kind == WRITTEN_CHEETAH else 4, count))
    fresh = np.zeros(count, np.bool_)
    return Plants(kind, bonus, state, fresh, mujoco, step_s, frames, cheetah, cheetah_work())


@kernel
def reset_plant(plants: Plants, lane: int, start: FloatArray) -> None:
    """Begin an episode at a state: as long as the plant's, MuJoCo's positions before its velocities."""
    plants.fresh[lane] = True
    if plants.mujoco.step == 0:
        for i in range(len(start)):
            plants.state[i, lane] = start[i]
        return
    mujoco = plants.mujoco
    call_with_thing(mujoco.reset, mujoco.model, mujoco.data[lane])
    for i in range(mujoco.positions):
        store(mujoco.qpos[lane] + 8 * i, start[i])
    for i in range(mujoco.velocities):
        store(mujoco.qvel[lane] + 8 * i, start[mujoco.positions + i])
    call_with_thing(mujoco.forward, mujoco.model, mujoco.data[lane])


@kernel
def observe(plants: Plants, lane: int, observations: FloatArray) -> None:
    """Write what an agent sees, in the order of the task's inputs, into its column (inputs, L)."""
    state, mujoco = plants.state, plants.mujoco
    if plants.kind == MOUNTAIN_CAR:
        observations[0, lane] = np.float32(state[0, lane])
        observations[1, lane] = np.float32(state[1, lane])
    elif plants.kind == CART_POLE:
        observations[0, lane] = np.float32(state[2, lane])
        observations[1, lane] = np.float32(state[3, lane])
    elif plants.kind == WRITTEN_PENDULUM:
        observations[0, lane] = state[1, lane]
        observations[1, lane] = state[0, lane]
    elif plants.kind == WRITTEN_CHEETAH:
        for i in range(1, 2 * COORDINATES):
            observations[i - 1, lane] = state[i, lane]
    elif plants.kind == PENDULUM:
        observations[0, lane] = load(mujoco.qpos[lane] + 8)
        observations[1, lane] = load(mujoco.qpos[lane])
    else:
        for i in range(1, mujoco.positions):
            observations[i - 1, lane] = load(mujoco.qpos[lane] + 8 * i)
        for i in range(mujoco.velocities):
            observations[mujoco.positions - 1 + i, lane] = load(mujoco.qvel[lane] + 8 * i)


@kernel
def step_plant(plants: Plants, lane: int, commands: FloatArray) -> tuple[float, float, bool]:
    """Advance one plant by the commands in its column (outputs, L), which must be within their limits.

    Returns Gymnasium's reward, the bonus on top of it, and whether the episode is over.
    """
    if plants.kind == MOUNTAIN_CAR:
        reward, over = step_mountain_car(plants.state, plants.fresh, lane, commands[0, lane])
        return reward, 0.0, over
    if plants.kind == CART_POLE:
        return 1.0, 0.0, step_cart_pole(plants.state, lane, _FORCE_N * commands[0, lane])
    if plants.kind == WRITTEN_PENDULUM:
        over = step_pendulum(plants.state, lane, plants.step_s, plants.frames, commands[0, lane])
        reward, bonus = upright(plants.bonus, plants.state[0, lane], over)
        return reward, bonus, over
    if plants.kind == WRITTEN_CHEETAH:
        return step_written_cheetah(plants, lane, commands), 0.0, False
    mujoco = plants.mujoco
    before = load(mujoco.qpos[lane])
    for i in range(mujoco.controls):
        store(mujoco.ctrl[lane] + 8 * i, commands[i, lane])
    for _ in range(mujoco.frames):
        call_with_thing(mujoco.step, mujoco.model, mujoco.data[lane])
    after = load(mujoco.qpos[lane])
    if plants.kind == PENDULUM:
        angle = load(mujoco.qpos[lane] + 8)
        over = not abs(angle) <= TILTED_RAD or not np.isfinite(after)
        reward, bonus = upright(plants.bonus, after, over)
        return reward, bonus, over
    return (after - before) / mujoco.dt_s - effort(commands, lane), 0.0, False


@kernel
def effort(commands: FloatArray, lane: int) -> float:
    """Return what a half-cheetah's commands cost."""
    squares = 0.0
    for i in range(commands.shape[0]):
        squares += commands[i, lane] * commands[i, lane]
    return _EFFORT * squares


@kernel
def step_written_cheetah(plants: Plants, lane: int, commands: FloatArray) -> float:
    """Step HalfCheetah-v5 without MuJoCo; returns the reward."""
    state, work = plants.state, plants.cheetah_work
    position, velocity = work.position, work.velocity
    for i in range(COORDINATES):
        position[i], velocity[i] = state[i, lane], state[COORDINATES + i, lane]
    for _ in range(plants.frames):
        step_cheetah(plants.cheetah, work, plants.step_s, commands, lane)
    moved = position[0] - state[0, lane]
    for i in range(COORDINATES):
        state[i, lane], state[COORDINATES + i, lane] = position[i], velocity[i]
    reward: float = moved / (plants.frames * plants.step_s) - effort(commands, lane)
    return reward


@kernel
def upright(bonus: float, x: float, over: bool) -> tuple[float, float]:
    """Return a pendulum's reward, and its bonus for a cart at x in m."""
    if over:
        return 0.0, 0.0
    return 1.0, bonus * (1.0 - abs(x))


@kernel
def step_mountain_car(
    state: FloatArray, fresh: NDArray[np.bool_], lane: int, action: float
) -> tuple[float, bool]:
    """Step MountainCarContinuous-v0, whose state is float32 but for the very first step."""
    position, velocity = state[0, lane], state[1, lane]
    tripled = 3.0 * position if fresh[lane] else np.float64(np.float32(3.0) * np.float32(position))
    speed = velocity + (action * _POWER - _SLOPE * math.cos(tripled))
    goal = _GOAL
    if abs(speed) <= _MOST_SPEED:
        place = position + speed
    else:
        speed = math.copysign(_MOST_SPEED, speed)
        place = position + speed
        if not fresh[lane]:
            # numpy adds a plain number to a float32 in float32, and compares so.
            place, goal = np.float64(np.float32(position) + np.float32(speed)), np.float64(np.float32(_GOAL))
    place = min(max(place, _LEFT_END), _RIGHT_END)
    if place == _LEFT_END and speed < 0.0:
        speed = 0.0
    over = place >= goal and speed >= 0.0
    state[0, lane], state[1, lane] = np.float32(place), np.float32(speed)
    fresh[lane] = False
    return (_AT_GOAL if over else 0.0) - 0.1 * (action * action), over


@kernel
def step_cart_pole(state: FloatArray, lane: int, force: float) -> bool:
    """Step CartPole-v1 by any force in N; returns whether it has fallen or left its rail."""
    x, x_dot, theta, theta_dot = state[0, lane], state[1, lane], state[2, lane], state[3, lane]
    cosine, sine = math.cos(theta), math.sin(theta)
    pushed = (force + _POLE_KG_M * (theta_dot * theta_dot) * sine) / _TOTAL_KG
    turned = (_GRAVITY * sine - cosine * pushed) / (
        _HALF_POLE_M * (4.0 / 3.0 - _POLE_KG * (cosine * cosine) / _TOTAL_KG)
    )
    moved = pushed - _POLE_KG_M * turned * cosine / _TOTAL_KG
    x += _TAU_S * x_dot
    theta += _TAU_S * theta_dot
    state[0, lane], state[2, lane] = x, theta
    state[1, lane] = x_dot + _TAU_S * moved
    state[3, lane] = theta_dot + _TAU_S * turned
    over: bool = abs(x) > _RAIL_M or abs(theta) > _FALLEN_RAD
    return over
