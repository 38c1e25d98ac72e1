"""Gymnasium's mountain car and its cart-pole, operation by operation."""

import math

import numpy as np
from numpy.typing import NDArray

from rover_ncp.kernels.jit import kernel

FloatArray = NDArray[np.float64]

# gymnasium/envs/classic_control/continuous_mountain_car.py
_POWER, _SLOPE = 0.0015, 0.0025
_MAX_SPEED, _LEFT_END, _RIGHT_END, _GOAL = 0.07, -1.2, 0.6, 0.45
_GOAL_REWARD = 100.0

# gymnasium/envs/classic_control/cartpole.py
_GRAVITY, _TAU_S, _HALF_POLE_M = 9.8, 0.02, 0.5
_POLE_KG, _TOTAL_KG = 0.1, 1.1
_POLE_KG_M = _POLE_KG * _HALF_POLE_M
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
    pushed = (_FORCE_N * action + _POLE_KG_M * (theta_dot * theta_dot) * sine) / _TOTAL_KG
    turned = (_GRAVITY * sine - cosine * pushed) / (
        _HALF_POLE_M * (4.0 / 3.0 - _POLE_KG * (cosine * cosine) / _TOTAL_KG)
    )
    moved = pushed - _POLE_KG_M * turned * cosine / _TOTAL_KG
    x += _TAU_S * x_dot
    theta += _TAU_S * theta_dot
    state[0, lane], state[2, lane] = x, theta
    state[1, lane] = x_dot + _TAU_S * moved
    state[3, lane] = theta_dot + _TAU_S * turned
    terminated: bool = abs(x) > _RAIL_M or abs(theta) > _FALLEN_RAD
    return terminated
