"""Rovers of a fleet against the rover alone, to the last bit; and the checks of Chipmunk's memory."""

import math

import numpy as np
import pymunk
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rover_ncp.core.errors import RoverNcpError
from rover_ncp.core.geometry import Pose, wrap_angle
from rover_ncp.course.course import Obstacle
from sim.world import chipmunk
from sim.world.described import default_rover
from sim.world.fleet import Fleet, advance, place, read_poses, send, wrapped
from sim.world.pymunk_rover import Ground, PymunkRover

BOX = (
    Obstacle(x=0.7, y=0.0, length=0.2, width=2.0),
    Obstacle(x=-0.7, y=0.0, length=0.2, width=2.0),
    Obstacle(x=0.0, y=0.7, theta=0.1, length=3.0, width=0.2),
    Obstacle(x=0.0, y=-0.7, length=3.0, width=0.2),
)


class Driven(Fleet):
    """A fleet that is driven tick by tick."""

    def place(self, lane, pose):
        place(self.arrays, lane, *pose)

    def tick(self, commands):
        """Send commands (2, L), advance by 0.1 s and return the poses (3, L)."""
        poses = np.empty((3, len(self.bodies)))
        send(self.arrays, np.ascontiguousarray(commands))
        advance(self.arrays)
        read_poses(self.arrays, poses)
        return poses

    @property
    def touched(self):
        return self.arrays.touched.astype(bool)


def models(count):
    """Rovers that differ in everything a kernel reads."""
    return [
        default_rover(
            accel=0.2 + 0.02 * i,
            decel=0.5,
            alpha=1.0 + 0.1 * i,
            alpha_decel=0.7,
            delay_v_s=0.01 * i,
            delay_omega_s=0.60 - 0.02 * i,
            friction=0.01 + 0.05 * i,
            omega_max=1.5,
            turn_gain=1.0 + 0.1 * (i % 5),
            rotation_center_m=0.02 * (i % 4) - 0.03,
        )
        for i in range(count)
    ]


def random_commands(seed, ticks, lanes, v, omega):
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform((-v, -omega), (v, omega), (-(-ticks // 10), lanes, 2)), 10, axis=0)[:ticks]


def drive_alone(model, obstacles, start, commands):
    """Return the poses (ticks, 3) and whether anything was touched."""
    rover = PymunkRover(model, Ground(obstacles), start)
    poses, touched = [], False
    for v, omega in commands.tolist():
        rover.command(v, omega)
        for _ in range(10):
            rover.substep()
            touched = touched or rover.in_contact
        poses.append(rover.pose)
    return np.array(poses), touched


@pytest.mark.parametrize(
    ("lanes", "obstacles", "touching"),
    [(12, (), 0), (29, (), 0), (13, BOX[:1], 3), (16, BOX, 15)],
)
def test_each_rover_of_a_fleet_goes_as_it_would_alone(lanes, obstacles, touching):
    start = Pose(0.0, 0.01, 0.2)
    commands = random_commands(3, 150, lanes, 0.5, 2.0)
    fleet = Driven(models(lanes), obstacles)
    for lane in range(lanes):
        fleet.place(lane, start)
    poses = np.array([fleet.tick(command.T) for command in commands])
    for lane, model in enumerate(models(lanes)):
        alone, touched = drive_alone(model, obstacles, start, commands[:, lane])
        assert np.array_equal(poses[:, :, lane], alone)
        assert fleet.touched[lane] == touched
    assert fleet.touched.sum() >= touching
    assert obstacles or not fleet.touched.any()


def test_shapes_and_mirrored_drives_change_no_bit_on_open_ground():
    seed, lanes, far = 0, 28, (Obstacle(x=1000.0, y=0.0, length=0.2, width=2.0),)
    commands = random_commands(seed, 120, lanes, 0.5, 2.0)
    commands[:, :4] = 0.0
    commands[:60, 4:8] = 0.0
    places = np.random.default_rng(seed).uniform(-3.0, 3.0, (lanes, 3))
    places[:8] = 0.0
    unmirrored = []
    for mirror in np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0]]):
        starts = [Pose(*start) for start in (places * mirror + 0.0).tolist()]
        sent = commands * mirror[[0, 2]]
        poses = {}
        for obstacles in ((), far):
            fleet = Driven(models(lanes), obstacles)
            assert any(body.shapes for body in fleet.bodies) == bool(obstacles)
            for lane, start in enumerate(starts):
                fleet.place(lane, start)
            poses[obstacles] = np.array([fleet.tick(row.T) for row in sent])
            assert not fleet.touched.any()
        assert poses[()].tobytes() == poses[far].tobytes()
        for lane, model in enumerate(models(lanes)):
            alone, _ = drive_alone(model, (), starts[lane], sent[:, lane])
            assert np.ascontiguousarray(poses[()][:, :, lane]).tobytes() == alone.tobytes()
        unmirrored.append(poses[()] * mirror[:, None])
    assert np.array_equal(*unmirrored)


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


def test_bodies_keep_chipmunks_own_velocity_function():
    # The first words of a body are the functions that move it.
    # Another function in its place would have to be of the same C type, or what happens is undefined.
    fleet = Fleet(models(1))
    own = pymunk.Body(1.0, 1.0)
    assert bytes(chipmunk._memory(fleet.bodies[0]))[:16] == bytes(chipmunk._memory(own))[:16]
