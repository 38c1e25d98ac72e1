"""Rovers of a fleet against the rover alone, to the last bit; and the doubts about Chipmunk's memory."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rover_ncp.core.course import Obstacle
from rover_ncp.core.errors import RoverNcpError
from rover_ncp.core.geometry import Pose, wrap_angle
from sim.world import chipmunk
from sim.world.bay import Bay
from sim.world.fleet import Fleet, wrapped
from sim.world.rover import Rover, RoverModel

BOX = (
    Obstacle(x=0.7, y=0.0, length=0.2, width=2.0),
    Obstacle(x=-0.7, y=0.0, length=0.2, width=2.0),
    Obstacle(x=0.0, y=0.7, theta=0.1, length=3.0, width=0.2),
    Obstacle(x=0.0, y=-0.7, length=3.0, width=0.2),
)


def models(count):
    """Rovers that differ in everything a kernel reads."""
    return [
        RoverModel(
            accel=0.2 + 0.02 * i,
            decel=0.5,
            alpha=1.0 + 0.1 * i,
            alpha_decel=0.7,
            delay_v_s=0.01 * i,
            delay_omega_s=0.37 - 0.02 * i,
            friction=0.01 + 0.05 * i,
            omega_max=1.5,
        )
        for i in range(count)
    ]


def random_commands(seed, ticks, lanes, v, omega):
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform((-v, -omega), (v, omega), (-(-ticks // 10), lanes, 2)), 10, axis=0)[:ticks]


def drive_alone(model, obstacles, start, commands):
    """Return the poses (ticks, 3) and whether anything was touched."""
    rover = Rover(model, Bay(obstacles), start)
    poses, touched = [], False
    for v, omega in commands.tolist():
        rover.command(v, omega)
        for _ in range(10):
            rover.substep()
            touched = touched or rover.in_contact
        poses.append(rover.pose)
    return np.array(poses), touched


@pytest.mark.parametrize(
    ("lanes", "obstacles", "touching"), [(12, (), 0), (16, (), 0), (16, BOX[:1], 3), (16, BOX, 15)]
)
def test_each_rover_of_a_fleet_goes_as_it_would_alone(lanes, obstacles, touching):
    start = Pose(0.0, 0.01, 0.2)
    commands = random_commands(3, 150, lanes, 0.5, 2.0)
    fleet = Fleet(models(lanes), obstacles)
    for lane in range(lanes):
        fleet.place(lane, start)
    poses = np.array([fleet.tick(np.ascontiguousarray(command.T)) for command in commands])
    for lane, model in enumerate(models(lanes)):
        alone, touched = drive_alone(model, obstacles, start, commands[:, lane])
        assert np.array_equal(poses[:, :, lane], alone)
        assert fleet.touched[lane] == touched
    assert fleet.touched.sum() >= touching
    assert obstacles or not fleet.touched.any()


def test_a_mirror_image_shows_in_no_bit_not_even_where_there_is_nothing_to_see():
    fleet, commands = Fleet([RoverModel()] * 8), np.zeros((8, 20, 2))
    commands[2:, :, 0] = 0.3
    commands[4:, 10:, 1] = np.linspace(-0.4, 0.4, 4)[:, None]
    poses = np.array([fleet.tick(np.ascontiguousarray(command.T)) for command in np.swapaxes(commands, 0, 1)])
    for lane in range(8):
        alone, _ = drive_alone(RoverModel(), (), Pose(0.0, 0.0, 0.0), commands[lane])
        assert np.ascontiguousarray(poses[:, :, lane]).tobytes() == alone.tobytes()


def test_a_rover_placed_again_is_as_good_as_new():
    start, model = Pose(0.0, 0.0, 0.0), RoverModel()
    commands = random_commands(8, 200, 8, 0.5, 2.0)
    fleet = Fleet([model] * 8, BOX)
    for command in commands:
        fleet.tick(np.ascontiguousarray(command.T))
    assert fleet.touched.any()
    for _ in range(2):  # the second time without what the last contact left over
        for lane in range(8):
            fleet.place(lane, start)
        fleet.tick(np.zeros((2, 8)))
    for lane in range(8):
        fleet.place(lane, start)
    poses = np.array([fleet.tick(np.ascontiguousarray(command.T)) for command in commands])
    for lane in range(8):
        assert np.array_equal(poses[:, :, lane], drive_alone(model, BOX, start, commands[:, lane])[0])


def test_a_fleet_fills_whole_bays():
    with pytest.raises(ValueError, match="multiple of 4"):
        Fleet([RoverModel()] * 9)


@settings(max_examples=300)
@given(st.floats(-1e4, 1e4) | st.integers(-40, 40).map(lambda n: n * math.pi))
def test_headings_wrap_as_everywhere_else(angle):
    assert wrapped(angle) == wrap_angle(angle)


def test_another_pymunk_is_refused_rather_than_misread(monkeypatch):
    chipmunk.find_layout.cache_clear()
    monkeypatch.setattr(chipmunk, "_SEARCHED", 120)  # as if the fields beyond were elsewhere
    with pytest.raises(RoverNcpError, match=r"pymunk .* keeps a body's position elsewhere"):
        chipmunk.find_layout()
    monkeypatch.setattr(chipmunk, "_SEARCHED", 200)
    with pytest.raises(RoverNcpError, match="a body's contacts elsewhere"):
        chipmunk.find_layout()
