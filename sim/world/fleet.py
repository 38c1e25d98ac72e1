"""Many rovers stepped together from inside a kernel, each to the last bit as ``PymunkRover`` would go.

The rules are those of ``rover.py``, repeated on arrays. Every substep of every rover is Chipmunk's own step.
An integrator of our own would be a second simulator.

Rovers have a shape only if there are obstacles. Without contacts, a shape never changes how a body moves, and
keeping shapes up to date takes more than half of a step. ``touched`` then stays 0.

Rovers that share a space do not collide with each other, and Chipmunk works relative to the space's origin.
So a rover's path does not depend on the others. SHARING_OPEN and SHARING_OBSTACLES say how many share one.

One thread at a time may use a fleet.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.course.course import Obstacle
from rover_ncp.kernels.jit import inlined_kernel, kernel
from rover_ncp.kernels.vectors import (
    WIDTH,
    gather,
    larger,
    load_lanes,
    scatter,
    smaller,
    store_lanes,
    where_less,
)
from sim.world import chipmunk
from sim.world.pymunk_rover import Ground, rover_body
from sim.world.rover import GRAVITY_M_S2, SUBSTEP_S, SUBSTEPS, RoverModel, own_axes

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SHARING_OPEN, SHARING_OBSTACLES = 24, 4
"""Rovers that share a space, at most: without obstacles and with them. Multiples or divisors of WIDTH."""


class FleetArrays(NamedTuple):
    """Arrays of the kernels; L rovers, as many lanes. Speeds in m/s and rad/s."""

    layout: chipmunk.Layout
    spaces: IntArray
    """(spaces,) addresses."""
    sharing: int
    """Lane n is in space n // ``sharing``."""
    bodies: IntArray
    """(L,) addresses."""
    shapes: IntArray
    """(L,) addresses; (0,) without obstacles."""
    eights: IntArray
    """The bodies once more, the last of them until all eights are full."""
    rise: FloatArray
    fall: FloatArray
    """(2, L) the most that v and the body's omega change in a substep, while they grow and while they
    shrink."""
    grip: FloatArray
    """(1, L) the most that the sideways speed changes in a substep."""
    top: FloatArray
    """(2, L) limits of v and omega, of the wheels."""
    turning: FloatArray
    """(2, L) turn gain, and the sideways speed over the turn rate in m."""
    waits: IntArray
    late: FloatArray
    """(2, L) delay of v and omega: whole ticks, and the substeps beyond; see ``set_delay``."""
    due: FloatArray
    """(ticks kept, 2, L) ring of targets: what falls due in this tick at row ``clock``, later ones behind."""
    clock: IntArray
    """(1,)."""
    old: FloatArray
    target: FloatArray
    """(2, L) work: the targets until others fall due in this tick, and those that were sent."""
    touched: IntArray
    """(L,) 1 if a rover touched anything since it was placed."""


class Fleet:
    """Rovers on copies of one ground; ``arrays`` is for the kernels of this module."""

    def __init__(self, models: Sequence[RoverModel], obstacles: Sequence[Obstacle] = ()) -> None:
        sharing, lanes = SHARING_OBSTACLES if obstacles else SHARING_OPEN, len(models)
        # The kernels use the addresses of these objects, which must therefore live as long.
        self.grounds = [Ground(obstacles) for _ in range(0, lanes, sharing)]
        self.bodies = [
            rover_body(model, self.grounds[lane // sharing], has_shape=bool(obstacles))
            for lane, model in enumerate(models)
        ]
        if not obstacles:
            for ground in self.grounds:
                ground.space.iterations = 1  # there will be no contact to solve
                ground.space.collision_bias = 0.0
        delay = np.array([(m.delay_v_substeps, m.delay_omega_substeps) for m in models])
        bodies = np.array([chipmunk.body_address(body) for body in self.bodies])
        self.arrays = FleetArrays(
            layout=chipmunk.find_layout(),
            spaces=np.array([chipmunk.space_address(ground.space) for ground in self.grounds]),
            sharing=sharing,
            bodies=bodies,
            shapes=np.array(
                [chipmunk.shape_address(shape) for body in self.bodies for shape in body.shapes], np.int64
            ),
            eights=np.pad(bodies, (0, -lanes % WIDTH), mode="edge"),
            rise=SUBSTEP_S * np.array([(m.accel, m.alpha) for m in models]).T.copy(),
            fall=SUBSTEP_S * np.array([(m.decel, m.alpha_decel) for m in models]).T.copy(),
            grip=np.array([[m.friction * GRAVITY_M_S2 * SUBSTEP_S for m in models]]),
            top=np.array([(m.v_max, m.omega_max) for m in models]).T.copy(),
            turning=np.array([(m.turn_gain, m.rotation_center_m) for m in models]).T.copy(),
            waits=np.zeros((2, lanes), np.int64),
            late=np.zeros((2, lanes)),
            due=np.zeros((int(delay.max()) // SUBSTEPS + 1, 2, lanes)),
            clock=np.zeros(1, np.int64),
            old=np.zeros((2, lanes)),
            target=np.zeros((2, lanes)),
            touched=np.zeros(lanes, np.int64),
        )
        for limit in (self.arrays.rise, self.arrays.fall):
            limit[1] *= self.arrays.turning[0]
        for lane, (delay_v, delay_omega) in enumerate(delay.tolist()):
            set_delay(self.arrays, lane, delay_v, delay_omega)


@kernel
def place(fleet: FleetArrays, lane: int, x: float, y: float, theta: float) -> None:
    """Put a rover somewhere, standing still, its commands forgotten.

    Chipmunk keeps the part of a contact that it applies in the next step: a rover that touched something must
    be placed a second time, after a step in the open.
    """
    body, layout, has_shape = fleet.bodies[lane], fleet.layout, len(fleet.shapes) > 0
    space = fleet.spaces[lane // fleet.sharing]
    # A shape taken out and put in again has left its contacts behind, and the hints that collision detection
    # keeps for its next search; with them the last bits of a path would depend on the rover's past.
    if has_shape:
        chipmunk.call_with_thing(layout.remove_shape, space, fleet.shapes[lane])
    chipmunk.store(body + layout.position, x)
    chipmunk.store(body + layout.position + 8, y)
    chipmunk.call_with_number(layout.set_angle, body, theta)
    chipmunk.store(body + layout.velocity, 0.0)
    chipmunk.store(body + layout.velocity + 8, 0.0)
    chipmunk.store(body + layout.angular_velocity, 0.0)
    if has_shape:
        chipmunk.add_thing(layout.add_shape, space, fleet.shapes[lane])
    for axis in range(2):
        fleet.old[axis, lane] = 0.0
        for row in range(len(fleet.due)):
            fleet.due[row, axis, lane] = 0.0
    fleet.touched[lane] = 0


@kernel
def set_delay(fleet: FleetArrays, lane: int, delay_v: int, delay_omega: int) -> None:
    """Set after how many substeps commands fall due: at most those of the slowest model of the fleet."""
    for axis, substeps in enumerate((delay_v, delay_omega)):
        fleet.waits[axis, lane] = substeps // SUBSTEPS
        fleet.late[axis, lane] = substeps % SUBSTEPS


@inlined_kernel
def send(fleet: FleetArrays, commands: FloatArray) -> None:
    """Command all rovers, (2, L): forward speed in m/s and rate of turn in rad/s; begins a tick."""
    top, due, waits, old, targets = fleet.top, fleet.due, fleet.waits, fleet.old, fleet.target
    fallen_due = due[fleet.clock[0]]
    clock = (fleet.clock[0] + 1) % len(due)
    fleet.clock[0] = clock
    for axis in range(2):
        for start in range(0, len(fleet.bodies), WIDTH):
            store_lanes(old, axis, start, load_lanes(fallen_due, axis, start))
            limit = load_lanes(top, axis, start)
            command = smaller(larger(load_lanes(commands, axis, start), -1.0 * limit), limit)
            if axis == 1:
                command = load_lanes(fleet.turning, 0, start) * command
            store_lanes(targets, axis, start, command)
        # The longest delay ends in the row of the tick before, whose targets are in ``old`` by now.
        for lane in range(len(fleet.bodies)):
            row = clock + waits[axis, lane]
            due[row if row < len(due) else row - len(due), axis, lane] = targets[axis, lane]


@inlined_kernel
def advance(fleet: FleetArrays) -> None:
    """Advance all rovers by the ten substeps of a tick."""
    # Local names: numba counts references whenever an array is taken out of a tuple.
    layout, bodies, eights, spaces = fleet.layout, fleet.bodies, fleet.eights, fleet.spaces
    old, new, late, rise, fall = fleet.old, fleet.due[fleet.clock[0]], fleet.late, fleet.rise, fleet.fall
    grip, turning, shapes, touched = fleet.grip, fleet.turning, fleet.shapes, fleet.touched
    sharing = fleet.sharing
    # Whole vectors and whole spaces: few enough rovers to stay in a core's first cache over a tick.
    together = max(sharing, WIDTH)
    for first in range(0, len(bodies), together):
        end = min(first + together, len(bodies))
        for substep in range(SUBSTEPS):
            now = float(substep)
            for start in range(first, end, WIDTH):
                cos, sin = gather(eights, start, layout.rotation), gather(eights, start, layout.rotation + 8)
                vx, vy = gather(eights, start, layout.velocity), gather(eights, start, layout.velocity + 8)
                omega = gather(eights, start, layout.angular_velocity)
                forward, sideways = _own_axes(cos, sin, vx, vy, omega)
                target = where_less(
                    now, load_lanes(late, 0, start), load_lanes(old, 0, start), load_lanes(new, 0, start)
                )
                forward = toward(forward, target, load_lanes(rise, 0, start), load_lanes(fall, 0, start))
                target = where_less(
                    now, load_lanes(late, 1, start), load_lanes(old, 1, start), load_lanes(new, 1, start)
                )
                omega = toward(omega, target, load_lanes(rise, 1, start), load_lanes(fall, 1, start))
                friction = load_lanes(grip, 0, start)
                sideways = toward(sideways, load_lanes(turning, 1, start) * omega, friction, friction)
                scatter(eights, start, layout.velocity, cos * forward - sin * sideways)
                scatter(eights, start, layout.velocity + 8, sin * forward + cos * sideways)
                scatter(eights, start, layout.angular_velocity, omega)
            for space in range(first // sharing, (end - 1) // sharing + 1):
                chipmunk.call_with_number(layout.step, spaces[space], SUBSTEP_S)
            for lane in range(first, min(end, len(shapes))):
                if chipmunk.load_word(bodies[lane] + layout.contacts) != 0:
                    touched[lane] = 1


_own_axes = kernel(own_axes)


@kernel
def toward(speed, target, rise, fall):  # type: ignore[no-untyped-def]  # vectors, which have no type here
    """Return ``rover.toward``, place by place."""
    step = where_less(speed * (target - speed), 0.0, fall, rise)
    return smaller(larger(target, speed - step), speed + step)


@inlined_kernel
def read_poses(fleet: FleetArrays, poses: FloatArray) -> None:
    """Write the true poses (3, L): x and y in m, heading in rad within (−π, π]."""
    for lane in range(len(fleet.bodies)):
        read_pose(fleet, poses, lane)


@inlined_kernel
def read_pose(fleet: FleetArrays, poses: FloatArray, lane: int) -> None:
    """Write one rover's pose."""
    body, layout = fleet.bodies[lane], fleet.layout
    poses[0, lane] = chipmunk.load(body + layout.position)
    poses[1, lane] = chipmunk.load(body + layout.position + 8)
    poses[2, lane] = wrapped(chipmunk.load(body + layout.angle))


@kernel
def push(fleet: FleetArrays, lane: int, x: float, y: float, theta: float) -> None:
    """Shift a rover at once; it keeps its velocity."""
    body, layout = fleet.bodies[lane], fleet.layout
    chipmunk.store(body + layout.position, chipmunk.load(body + layout.position) + x)
    chipmunk.store(body + layout.position + 8, chipmunk.load(body + layout.position + 8) + y)
    chipmunk.call_with_number(layout.set_angle, body, chipmunk.load(body + layout.angle) + theta)


@kernel
def wrapped(angle: float) -> float:
    """Return the same direction within (−π, π], to the last bit as ``geometry.wrap_angle`` does."""
    if -math.pi < angle <= math.pi:
        return angle
    angle = np.fmod(angle, math.tau)
    if angle > math.pi:
        angle -= math.tau
    elif angle <= -math.pi:
        angle += math.tau
    return angle
