"""Motions of the MuJoCo body beside those of Coulomb friction."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from sim.world.described import default_rover
from sim.world.mujoco_rover import MujocoRover
from sim.world.rover import SUBSTEP_S
from sim.world.skid_robot import Contact, SkidRobot

V_M_S, OMEGA_RAD_S = 0.16, 0.18
"""The fastest that a policy drives."""
SETTLED_S = 3.0
"""Time from a command until the motion is steady."""


class Motion(NamedTuple):
    """Steady motion for the motion that the encoders see."""

    forward_m_s: float
    turn_gain: float
    """True turn over the encoders' turn; NaN without one."""
    slide_m: float
    """Speed to the left over the rate of turn; NaN without one."""


def coulomb(robot: SkidRobot, v: float, omega: float, heading: float = 0.0) -> Motion:
    """Return the motion of a robot with dry friction whose encoders see ``v`` and ``omega``.

    The tyres slide so that friction's power less gravity's is least: forces and moments are then balanced.
    With the weight in the middle of level ground, the effective half track is t + L²/t, of half the track and
    wheelbase.
    """
    wheelbase, track = robot.half_wheelbase_m, robot.half_track_m
    ahead = wheelbase * np.array([1.0, 1.0, -1.0, -1.0])
    left = track * np.array([1.0, -1.0, 1.0, -1.0])
    x, y = robot.mass_center_m
    load = (1.0 + ahead * x / wheelbase**2) * (1.0 + left * y / track**2)
    rim = v - np.sign(left) * omega * robot.nominal_half_track_m
    pull = len(load) * math.tan(robot.slope_rad) / robot.friction
    downhill = robot.uphill_rad + math.pi - heading

    def power(motion: NDArray[np.float64]) -> float:
        forward, aside, turn = motion
        slide = np.sum(load * np.hypot(rim - (forward - turn * left), aside + turn * ahead))
        ahead_m_s, left_m_s = forward - turn * y, aside + turn * x  # of the weight
        return float(slide - pull * (math.cos(downhill) * ahead_m_s + math.sin(downhill) * left_m_s))

    found = np.array([v, 0.0, omega])
    for _ in range(2):  # the simplex may collapse on an edge, and is then built again
        settings = {"xatol": 1e-10, "fatol": 1e-14, "maxiter": 5000}
        found = minimize(power, found, method="Nelder-Mead", options=settings).x
    forward, aside, turn = found.tolist()
    return Motion(forward, turn / omega if omega else math.nan, aside / turn if omega else math.nan)


def measure(robot: SkidRobot, v: float, omega: float) -> Motion:
    """Drive with a steady command and return the motion."""
    rover = MujocoRover(default_rover(), robot)
    rover.command(v, omega)
    advance(rover, SETTLED_S)
    start, seconds = rover.turned, 5.0
    ways = np.zeros(3)  # ahead, to the left, turned by the encoders
    for _ in range(round(seconds / SUBSTEP_S)):
        x, y, _ = rover.pose
        rover.substep()
        theta = rover.pose.theta
        dx, dy = rover.pose.x - x, rover.pose.y - y
        cos, sin = math.cos(theta), math.sin(theta)
        ways += cos * dx + sin * dy, cos * dy - sin * dx, SUBSTEP_S * rover.encoders.omega
    turned = rover.turned - start
    return Motion(
        float(ways[0]) / seconds,
        turned / float(ways[2]) if omega else math.nan,
        float(ways[1]) / turned if omega else math.nan,
    )


def advance(rover: MujocoRover, seconds: float) -> None:
    """Let time pass."""
    for _ in range(round(seconds / SUBSTEP_S)):
        rover.substep()


def stopping_m(robot: SkidRobot, v: float) -> float:
    """Return the way from the moment at which braking begins at ``v``."""
    rover = MujocoRover(default_rover(delay_v_s=0.0), robot)
    rover.command(v, 0.0)
    advance(rover, SETTLED_S)
    start = rover.pose.x
    rover.command(0.0, 0.0)
    advance(rover, 2.0)
    return rover.pose.x - start


def creep_m_s(robot: SkidRobot) -> float:
    """Return the speed of a rover that stands on its slope."""
    rover = MujocoRover(default_rover(), robot)
    advance(rover, SETTLED_S)
    start, seconds = rover.pose, 10.0
    advance(rover, seconds)
    return math.hypot(rover.pose.x - start.x, rover.pose.y - start.y) / seconds


def downhill_m(robot: SkidRobot) -> float:
    """Return how far a robot slides downhill per radian, in a full turn on the spot."""
    rover = MujocoRover(default_rover(), robot)
    rover.command(0.0, OMEGA_RAD_S)
    advance(rover, SETTLED_S)
    start, turned = rover.pose, rover.turned
    while rover.turned < turned + math.tau:
        rover.substep()
    way = rover.pose.x - start.x, rover.pose.y - start.y
    return -(way[0] * math.cos(robot.uphill_rad) + way[1] * math.sin(robot.uphill_rad)) / math.tau


def coulomb_downhill_m(robot: SkidRobot) -> float:
    """Return the same by dry friction."""
    slides = []
    for heading in np.linspace(0.0, math.tau, 8, endpoint=False):
        motion, downhill = coulomb(robot, 0.0, OMEGA_RAD_S, heading), robot.uphill_rad + math.pi - heading
        ahead_m = motion.forward_m_s / (motion.turn_gain * OMEGA_RAD_S)
        slides.append(math.cos(downhill) * ahead_m + math.sin(downhill) * motion.slide_m)
    return float(np.mean(slides))


def shake_m_s2(robot: SkidRobot, omega: float) -> float:
    """Return the spread of the vertical acceleration while the rover turns on the spot: does it hop?"""
    rover = MujocoRover(default_rover(), robot)
    rover.command(0.0, omega)
    advance(rover, SETTLED_S)
    vertical = []
    for _ in range(300):
        rover.substep()
        vertical.append(float(rover.data.sensor("accelerometer").data[2]))
    return float(np.std(vertical))


SETTINGS = {
    "as shipped": Contact(),
    "half the step": Contact(step_s=0.5 * Contact().step_s),
    "10 times stickier": Contact(stickiness=10.0),
    "stiffer tyres": Contact(tyre_s=0.5 * Contact().tyre_s),
    "softer tyres": Contact(tyre_s=2.0 * Contact().tyre_s),
}
