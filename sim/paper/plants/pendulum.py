"""Gymnasium's inverted pendulum written out: MuJoCo's motion in less than a twentieth of the time.

The paper's budget of 500 million steps a run needs it.

The pole turns on a hinge (positive about y) on a cart on a slider (along x), from ``inverted_pendulum.xml``:
capsules of MuJoCo's default density that touch nothing, friction in both joints, Runge-Kutta steps of fourth
order. Within the ends of the slider the motion is MuJoCo's up to rounding. At an end MuJoCo pushes the cart
back; here the episode ends, so an agent never earns more here than there. The hinge's limits are far beyond
the tilt that ends an episode.
"""

import math

import numpy as np
from numpy.typing import NDArray

from rover_ncp.kernels.jit import kernel

FloatArray = NDArray[np.float64]

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
