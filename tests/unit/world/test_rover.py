"""The rover against the paper's kinematics written down a second time, and against things in its way."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.course.course import Obstacle
from sim.world.described import default_rover
from sim.world.pymunk_rover import Ground, PymunkRover

WALL = Obstacle(x=1.0, y=0.0, length=0.2, width=4.0)
WALL_FACE_X = 0.9


def papers_kinematics(commands, delay_v, delay_omega):
    """Poses (ticks + 1, 3) of the paper's point rover for commands (ticks, 2), in its order of operations."""
    dt, accel, alpha = 0.01, 0.31, 1.25
    x = y = theta = v = omega = 0.0
    poses = [(x, y, theta)]
    for substep in range(10 * len(commands)):
        tick_v, tick_omega = (substep - delay_v) // 10, (substep - delay_omega) // 10
        v_wanted = commands[tick_v][0] if tick_v >= 0 else 0.0
        omega_wanted = commands[tick_omega][1] if tick_omega >= 0 else 0.0
        v += np.clip(v_wanted - v, -accel * dt, accel * dt)
        omega += np.clip(omega_wanted - omega, -alpha * dt, alpha * dt)
        x += dt * math.cos(theta) * v
        y += dt * math.sin(theta) * v
        theta += dt * omega
        if substep % 10 == 9:
            poses.append((x, y, theta))
    return np.array(poses)


def drive(rover, commands):
    poses = [rover.pose]
    for v, omega in commands:
        rover.command(v, omega)
        for _ in range(10):
            rover.substep()
        poses.append(rover.pose)
    return np.array(poses)


@st.composite
def drives(draw):
    """32 s of commands: held for a while or changed each tick, anywhere in range or at its ends."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    held = draw(st.sampled_from([1, 2, 7, 40]))
    v_low = draw(st.sampled_from([0.0, -0.16]))
    commands = rng.uniform((v_low, -0.18), (0.16, 0.18), (-(-320 // held), 2))
    if draw(st.booleans()):
        commands = np.where(rng.random(commands.shape) < 0.5, (v_low, -0.18), (0.16, 0.18))
    return np.repeat(commands, held, axis=0)[:320]


@settings(max_examples=settings().max_examples // 3)
@given(drives(), st.sampled_from([(15, 10), (3, 27)]))
def test_follows_the_papers_kinematics_in_open_ground(commands, delays):
    model = default_rover(delay_v_s=delays[0] / 100, delay_omega_s=delays[1] / 100)
    driven = drive(PymunkRover(model, Ground()), commands.tolist())
    expected = papers_kinematics(commands.tolist(), *delays)
    assert np.abs(driven[:, :2] - expected[:, :2]).max() < 1e-4
    turned = np.array([math.remainder(a, math.tau) for a in driven[:, 2] - expected[:, 2]])
    assert np.abs(turned).max() < 1e-4


@pytest.mark.parametrize("command", [(math.nan, 0.0), (0.0, math.inf)])
def test_refuses_a_command_that_is_no_number(command):
    rover = PymunkRover(default_rover(), Ground())
    with pytest.raises(ValueError, match="finite"):
        rover.command(*command)


def drive_at_the_wall(start):
    """Return the deepest overlap (m), whether contact was reported, and the rover after 20 s."""
    rover = PymunkRover(default_rover(), Ground([WALL]), start)
    corners = next(iter(rover.body.shapes)).get_vertices()
    rover.command(0.16, 0.0)
    deepest, touched = -math.inf, False
    for _ in range(2000):
        rover.substep()
        front = max(rover.body.local_to_world(corner).x for corner in corners)
        deepest = max(deepest, front - WALL_FACE_X)
        touched = touched or rover.in_contact
    return deepest, touched, rover


@pytest.mark.parametrize("heading", [0.0, 0.3])
def test_a_wall_stops_the_rover(heading):
    deepest, touched, rover = drive_at_the_wall(Pose(0.0, 0.0, heading))
    assert 0 < deepest < 0.002
    assert touched
    assert rover.in_contact
    assert rover.target == Velocity(0.16, 0.0)
    if heading == 0.0:  # it stalls, and backs off freely
        assert abs(rover.velocity.v) < 1e-3
        rover.command(-0.16, 0.0)
        for _ in range(200):
            rover.substep()
        assert rover.velocity.v == pytest.approx(-0.16)
        assert not rover.in_contact
