"""The MuJoCo body against theory, and independence of the simulator's settings."""

import math
from itertools import pairwise

import pytest
from kit.rigid_body import (
    advance,
    coulomb,
    measure,
)

from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import Obstacle
from sim.world.bodies import Body
from sim.world.described import default_rover
from sim.world.mujoco_rover import TICKS_PER_M, MujocoRover
from sim.world.randomization import load_randomization
from sim.world.skid_robot import Patches, SkidRobot, draw_robot

OMEGA = 0.18
AHEAD = SkidRobot(mass_center_m=(0.03, 0.0), friction=0.4)


def rover(robot=None, obstacles=(), **model):
    return MujocoRover(default_rover(**model), robot or SkidRobot(), obstacles)


def test_half_track_is_that_of_dry_friction_with_the_weight_in_the_middle():
    robot = SkidRobot()
    effective = robot.half_track_m + robot.half_wheelbase_m**2 / robot.half_track_m
    expected = robot.nominal_half_track_m / effective
    assert coulomb(robot, 0.0, OMEGA).turn_gain == pytest.approx(expected, rel=1e-4)
    for friction in (0.4, 1.0):
        slippery = robot.model_copy(update={"friction": friction})
        assert measure(slippery, 0.0, OMEGA).turn_gain == pytest.approx(expected, rel=0.01)


def test_encoders_count_the_wheels_and_the_gyro_the_body():
    body = rover(AHEAD)
    body.command(0.1, OMEGA)
    advance(body, 3.0)
    turned, believed = body.turned, 0.0
    for _ in range(200):
        body.substep()
        believed += 0.01 * body.encoders.omega
    assert believed == pytest.approx(2.0 * OMEGA, rel=0.01)
    assert body.turned - turned == pytest.approx(2.0 * body.velocity.omega, rel=0.02)
    assert body.turned - turned > 1.2 * believed
    assert body.moving
    body.command(0.0, 0.0)
    advance(body, 3.0)
    assert not body.moving
    ticks = []
    for _ in range(20):
        body.substep()
        ticks.append(body.encoders.v * 0.01 * TICKS_PER_M)
    assert all(2 * tick == pytest.approx(round(2 * tick), abs=1e-6) for tick in ticks)
    assert max(map(abs, ticks)) <= 1.0


def test_a_wall_stops_the_rover_and_is_seen():
    wall = Obstacle(x=1.0, y=0.0, length=0.2, width=4.0)
    body = rover(obstacles=[wall])
    assert body.range_along(Pose(0.3, 0.0, 0.0), 5.0) == pytest.approx(0.6)
    assert body.range_along(Pose(0.3, 0.0, 0.0), 0.5) is None
    assert body.range_along(Pose(0.3, 0.0, math.pi), 5.0) is None
    assert not body.in_contact
    body.command(0.16, 0.0)
    advance(body, 8.0)
    assert body.in_contact
    assert body.pose.x == pytest.approx(0.9 - 0.5 * body.model.length, abs=0.005)
    body.set_pose(Pose(-1.0, 0.5, 0.1))
    advance(body, 1.0)
    assert body.pose == pytest.approx(Pose(-1.0, 0.5, 0.1), abs=1e-3)
    assert not body.in_contact


def test_floor_is_slippery_on_every_second_square():
    board = Patches(size_m=2.0, friction=0.05)
    hill = SkidRobot(slope_rad=0.1, patches=board)
    for x, y, slippery in ((1.0, 1.0, True), (3.0, 1.0, False), (-1.0, -1.0, True), (-1.0, 1.0, False)):
        body = MujocoRover(default_rover(), hill, pose=Pose(x, y, 0.0))
        advance(body, 1.0)
        assert (x - body.pose.x > 0.1) == slippery
        assert abs(x - body.pose.x) > 0.1 or abs(x - body.pose.x) < 0.001


def test_a_trial_is_the_same_robot_in_every_set_of_trials():
    ranges = load_randomization("rough", Body.MUJOCO).skid_steer
    robots = [draw_robot(ranges, 1, number) for number in range(50)]
    assert draw_robot(ranges, 1, 7) == robots[7]
    assert all(one != other for one, other in pairwise(robots))
    for robot in robots:
        assert 9.6 <= robot.mass_kg <= 14.4
        assert math.hypot(*robot.mass_center_m) <= 0.06
        assert len(robot.cables) == 3
