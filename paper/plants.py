"""L plants of one kind, each lane in an episode of its own.

MuJoCo's step is called by its address (``mujoco.py``); the other plants are written out. The tests compare
each plant with its Gymnasium environment, step by step.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.kernels.jit import kernel
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


TILTED_RAD = 0.2
"""Tilt that ends an episode (gymnasium/envs/mujoco/inverted_pendulum_v5.py)."""

_DENSITY = 1000.0
_G = 9.81
_DAMPING = 1.0
"""N s/m of the slider, N m s/rad of the hinge."""
_GEAR_N = 100.0
_SLIDER_M = 1.0


def _capsule(radius: float, length: float) -> tuple[float, float]:
    """Return a capsule's mass in kg and its inertia in kg m² about a transverse axis through its middle."""
    tube = _DENSITY * math.pi * radius**2 * length
    caps = _DENSITY * 4.0 / 3.0 * math.pi * radius**3
    across = tube * (radius**2 / 4.0 + length**2 / 12.0)
    across += caps * (0.4 * radius**2 + 0.375 * radius * length + length**2 / 4.0)
    return tube + caps, across


_POLE_TOP_M = (0.001, 0.6)
_MIDDLE_X_M, _MIDDLE_Z_M = _POLE_TOP_M[0] / 2.0, _POLE_TOP_M[1] / 2.0
"""The middle of the upright pole, from the hinge."""
_CART_KG, _ = _capsule(0.1, 0.2)
_POLE_KG, _POLE_ACROSS = _capsule(0.049, math.hypot(*_POLE_TOP_M))
_TOTAL_KG = _CART_KG + _POLE_KG
_INERTIA = _POLE_ACROSS + _POLE_KG * (_MIDDLE_X_M**2 + _MIDDLE_Z_M**2)
"""Moment of inertia of the pole about the hinge."""


@kernel
def _accelerations(angle: float, speed: float, rate: float, force: float) -> tuple[float, float]:
    """Return the accelerations of cart and pole in m/s² and rad/s²."""
    sine, cosine = math.sin(angle), math.cos(angle)
    aside = _POLE_KG * (_MIDDLE_X_M * cosine + _MIDDLE_Z_M * sine)
    above = _POLE_KG * (_MIDDLE_Z_M * cosine - _MIDDLE_X_M * sine)
    push = force - _DAMPING * speed + aside * (rate * rate)
    turn = _G * aside - _DAMPING * rate
    determinant = _TOTAL_KG * _INERTIA - above * above
    return (_INERTIA * push - above * turn) / determinant, (_TOTAL_KG * turn - above * push) / determinant


@kernel
def step_pendulum(state: FloatArray, lane: int, step_s: float, frames: int, action: float) -> bool:
    """Advance x, angle and their rates, a column of (4, L), by ``frames`` steps; an action of 1 is 100 N.

    Returns termination: the cart was beyond an end of its slider, or the pole tilted too far.
    """
    x, angle, speed, rate = state[0, lane], state[1, lane], state[2, lane], state[3, lane]
    force, half = _GEAR_N * action, 0.5 * step_s
    beyond = False
    for _ in range(frames):
        a, b = _accelerations(angle, speed, rate, force)
        speed_2, rate_2 = speed + half * a, rate + half * b
        a_2, b_2 = _accelerations(angle + half * rate, speed_2, rate_2, force)
        speed_3, rate_3 = speed + half * a_2, rate + half * b_2
        a_3, b_3 = _accelerations(angle + half * rate_2, speed_3, rate_3, force)
        speed_4, rate_4 = speed + step_s * a_3, rate + step_s * b_3
        a_4, b_4 = _accelerations(angle + step_s * rate_3, speed_4, rate_4, force)
        furthest = max(abs(x + half * speed), abs(x + half * speed_2), abs(x + step_s * speed_3))
        x += step_s / 6.0 * (speed + 2.0 * (speed_2 + speed_3) + speed_4)
        angle += step_s / 6.0 * (rate + 2.0 * (rate_2 + rate_3) + rate_4)
        speed += step_s / 6.0 * (a + 2.0 * (a_2 + a_3) + a_4)
        rate += step_s / 6.0 * (b + 2.0 * (b_2 + b_3) + b_4)
        beyond = beyond or not max(furthest, abs(x)) <= _SLIDER_M
    state[0, lane], state[1, lane], state[2, lane], state[3, lane] = x, angle, speed, rate
    terminated: bool = beyond or not abs(angle) <= TILTED_RAD
    return terminated


# gymnasium/envs/classic_control/continuous_mountain_car.py
_POWER, _SLOPE = 0.0015, 0.0025
_MAX_SPEED, _LEFT_END, _RIGHT_END, _GOAL = 0.07, -1.2, 0.6, 0.45
_GOAL_REWARD = 100.0

# gymnasium/envs/classic_control/cartpole.py
_GRAVITY, _TAU_S, _HALF_POLE_M = 9.8, 0.02, 0.5
_CART_POLE_KG, _CART_TOTAL_KG = 0.1, 1.1
_CART_POLE_KG_M = _CART_POLE_KG * _HALF_POLE_M
_FORCE_N = 10.0
"""Force of a full action, that of the environment's two actions."""
_RAIL_M, _FALLEN_RAD = 2.4, 12 * 2 * math.pi / 360


@kernel
def step_mountain_car(
    state: FloatArray, fresh: NDArray[np.bool_], lane: int, action: float
) -> tuple[float, bool]:
    """Step MountainCarContinuous-v0; returns reward and termination.

    Its state (2, L) is float32, except before the first step of an episode.
    """
    position, velocity = state[0, lane], state[1, lane]
    tripled = 3.0 * position if fresh[lane] else np.float64(np.float32(3.0) * np.float32(position))
    speed = velocity + (action * _POWER - _SLOPE * math.cos(tripled))
    goal = _GOAL
    if abs(speed) <= _MAX_SPEED:
        place = position + speed
    else:
        speed = math.copysign(_MAX_SPEED, speed)
        place = position + speed
        if not fresh[lane]:
            # numpy adds a plain number to a float32 in float32, and compares so.
            place, goal = np.float64(np.float32(position) + np.float32(speed)), np.float64(np.float32(_GOAL))
    place = min(max(place, _LEFT_END), _RIGHT_END)
    if place == _LEFT_END and speed < 0.0:
        speed = 0.0
    terminated = place >= goal and speed >= 0.0
    state[0, lane], state[1, lane] = np.float32(place), np.float32(speed)
    fresh[lane] = False
    return (_GOAL_REWARD if terminated else 0.0) - 0.1 * (action * action), terminated


@kernel
def step_cart_pole(state: FloatArray, lane: int, action: float) -> bool:
    """Step CartPole-v1; returns termination: the pole fell or the cart left its rail."""
    x, x_dot, theta, theta_dot = state[0, lane], state[1, lane], state[2, lane], state[3, lane]
    cosine, sine = math.cos(theta), math.sin(theta)
    pushed = (_FORCE_N * action + _CART_POLE_KG_M * (theta_dot * theta_dot) * sine) / _CART_TOTAL_KG
    turned = (_GRAVITY * sine - cosine * pushed) / (
        _HALF_POLE_M * (4.0 / 3.0 - _CART_POLE_KG * (cosine * cosine) / _CART_TOTAL_KG)
    )
    moved = pushed - _CART_POLE_KG_M * turned * cosine / _CART_TOTAL_KG
    x += _TAU_S * x_dot
    theta += _TAU_S * theta_dot
    state[0, lane], state[2, lane] = x, theta
    state[1, lane] = x_dot + _TAU_S * moved
    state[3, lane] = theta_dot + _TAU_S * turned
    terminated: bool = abs(x) > _RAIL_M or abs(theta) > _FALLEN_RAD
    return terminated
