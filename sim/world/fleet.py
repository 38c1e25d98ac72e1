"""Many rovers stepped together in the native library, each to the last bit as ``PymunkRover`` would go.

The rules are those of ``rover.py``; ``rover_ncp/native/fleet.h`` repeats them on arrays. Every substep of
every rover is Chipmunk's own: an integrator of our own would be a second simulator.

Rovers have a shape only if there are obstacles. Without contacts, a shape never changes how a body moves, and
a step of the space does no more than Chipmunk's update of each body's position. The library calls that alone,
because the rest of the step would take a tenth of a training. ``touched`` then stays 0.

Rovers that share a space do not collide with each other, and Chipmunk works relative to the space's origin.
So a rover's path does not depend on the others.

One thread at a time may use a fleet.
"""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.course.course import Obstacle
from rover_ncp.native.core import WIDTH, Axes
from sim.world import chipmunk
from sim.world.pymunk_rover import Ground, rover_body
from sim.world.rover import GRAVITY_M_S2, SUBSTEP_S, SUBSTEPS, RoverModel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SHARING = 4
"""Rovers that share a space, at most: a divisor of WIDTH."""
assert WIDTH % SHARING == 0


class FleetArrays(NamedTuple):
    """Arrays of L rovers, as many lanes. Speeds in m/s and rad/s."""

    chipmunk: chipmunk.Functions
    spaces: Annotated[IntArray, Axes("lanes")]
    sharing: int
    """So many lanes after each other are in one space."""
    bodies: Annotated[IntArray, Axes("lanes")]
    shapes: Annotated[IntArray, Axes("lanes?")]
    """Addresses of each lane's; no shapes without obstacles."""
    rise: Annotated[FloatArray, Axes(2, "lanes")]
    fall: Annotated[FloatArray, Axes(2, "lanes")]
    """The most that v and the body's omega change in a substep, while they grow and while they shrink."""
    grip: Annotated[FloatArray, Axes(1, "lanes")]
    """The most that the sideways speed changes in a substep."""
    top: Annotated[FloatArray, Axes(2, "lanes")]
    """Limits of v and omega, of the wheels."""
    turning: Annotated[FloatArray, Axes(2, "lanes")]
    """Turn gain, and the sideways speed over the turn rate in m."""
    waits: Annotated[IntArray, Axes(2, "lanes", below="ticks_kept")]
    late: Annotated[FloatArray, Axes(2, "lanes")]
    """Delay of v and omega: whole ticks, and the substeps beyond."""
    due: Annotated[FloatArray, Axes("ticks_kept", 2, "lanes")]
    """Ring of targets: what falls due in this tick at row ``clock``, later ones behind."""
    clock: Annotated[IntArray, Axes(1, below="ticks_kept")]
    old: Annotated[FloatArray, Axes(2, "lanes")]
    target: Annotated[FloatArray, Axes(2, "lanes")]
    """Work: the targets until others fall due in this tick, and those that were sent."""
    velocity: Annotated[FloatArray, Axes(3, "lanes")]
    """Work: what Chipmunk has: x, y and rate of turn."""
    touched: Annotated[IntArray, Axes("lanes")]
    """1 if a rover touched anything since it was placed."""


class Fleet:
    """Rovers on copies of one ground; ``arrays`` is for the native library."""

    def __init__(self, models: Sequence[RoverModel], obstacles: Sequence[Obstacle] = ()) -> None:
        lanes = len(models)
        # The library uses the addresses of these objects, which must therefore live as long.
        self.grounds = [Ground(obstacles) for _ in range(0, lanes, SHARING)]
        self.bodies = [
            rover_body(model, self.grounds[lane // SHARING], has_shape=bool(obstacles))
            for lane, model in enumerate(models)
        ]
        delay = np.array([(m.delay_v_substeps, m.delay_omega_substeps) for m in models])
        self.arrays = FleetArrays(
            chipmunk=chipmunk.find_functions(),
            spaces=np.repeat([chipmunk.space_address(ground.space) for ground in self.grounds], SHARING)[
                :lanes
            ],
            sharing=SHARING,
            bodies=np.array([chipmunk.body_address(body) for body in self.bodies]),
            shapes=np.array(
                [chipmunk.shape_address(shape) for body in self.bodies for shape in body.shapes], np.int64
            ),
            rise=SUBSTEP_S * np.array([(m.accel, m.alpha) for m in models]).T.copy(),
            fall=SUBSTEP_S * np.array([(m.decel, m.alpha_decel) for m in models]).T.copy(),
            grip=np.array([[m.friction * GRAVITY_M_S2 * SUBSTEP_S for m in models]]),
            top=np.array([(m.v_max, m.omega_max) for m in models]).T.copy(),
            turning=np.array([(m.turn_gain, m.rotation_center_m) for m in models]).T.copy(),
            waits=(delay // SUBSTEPS).T.copy(),
            late=(delay % SUBSTEPS).T.astype(np.float64, order="C"),
            due=np.zeros((int(delay.max()) // SUBSTEPS + 1, 2, lanes)),
            clock=np.zeros(1, np.int64),
            old=np.zeros((2, lanes)),
            target=np.zeros((2, lanes)),
            velocity=np.zeros((3, lanes)),
            touched=np.zeros(lanes, np.int64),
        )
        for limit in (self.arrays.rise, self.arrays.fall):
            limit[1] *= self.arrays.turning[0]
