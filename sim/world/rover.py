"""One rover on pymunk: actuator delays, acceleration limits, contact.

Rules of this file, which ``fleet.py`` repeats for many rovers and the tests hold against it to the last bit:

1. A substep is 0.01 s. A command given before substep n is obeyed from substep n + delay on.
2. The rover has no speed of its own beside its body's: before each step the body's velocity is changed, along
   the rover by at most a·dt toward the commanded one, across it by at most μ·g·dt toward zero (wheels do not
   roll sideways), and its rotation by at most α·dt. What a collision did to the body is thereby kept, and a
   rover can push no harder than its wheels accelerate it. A speed that is being turned is not lost: the
   wheels' sideways force does no work (without that, a substep of turning would cost v·(ω·dt)²/2 of speed,
   which adds up to more than 0.1 mm over a manoeuvre).
3. Chipmunk then moves the position with the new velocity and the old heading, then the heading: the paper's
   kinematics (design, "The simulator's semantics").
"""

import math
from collections import deque
from dataclasses import dataclass, replace

import pymunk
from pydantic import Field

from rover_ncp.core.config import StrictModel
from rover_ncp.core.course import Course
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.geometry import Pose, Velocity, wrap_angle
from sim.world.bay import ROVER_FILTER, Bay

SUBSTEP_S = 0.01
"""Physics step in seconds, as in the paper's simulator."""

GRAVITY_M_S2 = 9.81

ORIGIN = Pose(0.0, 0.0, 0.0)


class RoverModel(StrictModel):
    """A Pioneer 3-AT as the paper's simulator has it; length, width and mass from the base's data sheet.

    Speeds in m/s and rad/s, accelerations in m/s² and rad/s²; ``decel`` and ``alpha_decel`` apply while the
    speed shrinks. Delays are whole substeps.
    """

    accel: float = Field(default=0.31, gt=0)
    decel: float = Field(default=0.31, gt=0)
    alpha: float = Field(default=1.25, gt=0)
    alpha_decel: float = Field(default=1.25, gt=0)
    v_max: float = Field(default=0.7, gt=0)
    omega_max: float = Field(default=2.44, gt=0)
    delay_v_s: float = Field(default=0.15, ge=0, le=2)
    delay_omega_s: float = Field(default=0.10, ge=0, le=2)
    length: float = Field(default=0.626, gt=0)
    width: float = Field(default=0.505, gt=0)
    mass: float = Field(default=12.0, gt=0)
    friction: float = Field(default=0.6, ge=0, description="μ of the wheels across the rover")
    shell_friction: float = Field(default=0.3, ge=0, description="of its sides against an obstacle")

    @property
    def delay_v_substeps(self) -> int:
        """Substeps that still run with the old forward speed."""
        return round(self.delay_v_s / SUBSTEP_S)

    @property
    def delay_omega_substeps(self) -> int:
        """Substeps that still run with the old rate of turn."""
        return round(self.delay_omega_s / SUBSTEP_S)


@dataclass(frozen=True)
class Limits:
    """Limits that a user can change while the base runs; same units as RoverModel."""

    accel: float
    decel: float
    alpha: float
    alpha_decel: float
    v_max: float
    omega_max: float

    @classmethod
    def of(cls, model: RoverModel) -> "Limits":
        """Return the limits a model starts with."""
        return cls(model.accel, model.decel, model.alpha, model.alpha_decel, model.v_max, model.omega_max)


def toward(speed: float, target: float, rise: float, fall: float) -> float:
    """Return ``speed`` moved toward ``target`` by at most ``rise``, or ``fall`` while its size shrinks.

    >>> toward(0.10, 0.16, 0.0031, 0.0062)
    0.1031
    """
    step = rise if speed * (target - speed) >= 0.0 else fall
    return min(max(target, speed - step), speed + step)


def own_axes(cos: float, sin: float, vx: float, vy: float, omega: float) -> tuple[float, float]:
    """Return the speeds along the rover and across it, from its heading, velocity and rate of turn.

    The velocity still points where the rover headed before the last substep turned it by ω·dt; the speed
    along the rover is what it was along that old heading (cosine and sine of ω·dt by their series).
    """
    forward = cos * vx + sin * vy
    sideways = cos * vy - sin * vx
    turn = omega * SUBSTEP_S
    square = turn * turn
    return forward * (1.0 - 0.5 * square) - sideways * (turn * (1.0 - square / 6.0)), sideways


def rover_body(model: RoverModel, bay: Bay, pose: Pose = ORIGIN, *, has_shape: bool = True) -> pymunk.Body:
    """Put a rover's body into a bay, standing still; without a shape it touches nothing."""
    size = (model.length, model.width)
    body = pymunk.Body(model.mass, pymunk.moment_for_box(model.mass, size))
    body.position, body.angle = (pose.x, pose.y), pose.theta
    bay.space.add(body)
    if has_shape:
        shape = pymunk.Poly.create_box(body, size)
        shape.filter = ROVER_FILTER
        shape.friction = model.shell_friction
        bay.space.add(shape)
    return body


def require_free_start(model: RoverModel, course: Course) -> None:
    """Raise ConfigError when the rover stands in an obstacle at the start of a course, the origin."""
    bay = Bay(course.obstacles)
    body = rover_body(model, bay)
    if any(bay.space.shape_query(shape) for shape in body.shapes):
        size = f"{model.length} m by {model.width} m"
        raise ConfigError(f"course {course.name}", [f"an obstacle stands where the rover starts ({size})"])


class Rover:
    """A rover alone in its bay. ``limits`` may be changed at any time."""

    def __init__(self, model: RoverModel, bay: Bay, pose: Pose = ORIGIN) -> None:
        self.model = model
        self.bay = bay
        self.limits = Limits.of(model)
        self.body = rover_body(model, bay, pose)
        self.substeps = 0
        self._v_target = self._omega_target = 0.0
        # (first substep that obeys it, value)
        self._v_queue: deque[tuple[int, float]] = deque()
        self._omega_queue: deque[tuple[int, float]] = deque()

    def command(self, v: float, omega: float) -> None:
        """Ask for a forward speed (m/s) and a rate of turn (rad/s), obeyed after the model's delays."""
        if not (math.isfinite(v) and math.isfinite(omega)):
            raise ValueError(f"a command must be finite, got v={v}, omega={omega}")
        self._v_queue.append((self.substeps + self.model.delay_v_substeps, v))
        self._omega_queue.append((self.substeps + self.model.delay_omega_substeps, omega))

    def change_limits(self, **limits: float) -> None:
        """Replace some of the limits, by name."""
        self.limits = replace(self.limits, **limits)

    def set_pose(self, pose: Pose) -> None:
        """Put the rover somewhere, standing still, all commands forgotten."""
        # A new body, because the old one would carry the last contact's correction into its next step.
        self.bay.space.remove(self.body, *self.body.shapes)
        self.body = rover_body(self.model, self.bay, pose)
        self._v_queue.clear()
        self._omega_queue.clear()
        self._v_target = self._omega_target = 0.0

    def push(self, shift: Pose) -> None:
        """Shift the rover's body at once, in the bay's frame; it keeps its velocity."""
        x, y = self.body.position
        self.body.position = (x + shift.x, y + shift.y)
        self.body.angle += shift.theta

    def substep(self) -> None:
        """Advance by 0.01 s."""
        while self._v_queue and self._v_queue[0][0] <= self.substeps:
            self._v_target = self._v_queue.popleft()[1]
        while self._omega_queue and self._omega_queue[0][0] <= self.substeps:
            self._omega_target = self._omega_queue.popleft()[1]
        self._drive()
        self.bay.space.step(SUBSTEP_S)
        self.substeps += 1

    def _drive(self) -> None:
        limits, target = self.limits, self.target
        cos, sin = self.body.rotation_vector
        vx, vy = self.body.velocity
        forward, sideways = own_axes(cos, sin, vx, vy, self.body.angular_velocity)
        forward = toward(forward, target.v, limits.accel * SUBSTEP_S, limits.decel * SUBSTEP_S)
        grip = self.model.friction * GRAVITY_M_S2 * SUBSTEP_S
        sideways = toward(sideways, 0.0, grip, grip)
        self.body.velocity = (cos * forward - sin * sideways, sin * forward + cos * sideways)
        self.body.angular_velocity = toward(
            self.body.angular_velocity,
            target.omega,
            limits.alpha * SUBSTEP_S,
            limits.alpha_decel * SUBSTEP_S,
        )

    @property
    def target(self) -> Velocity:
        """The velocity that the rover accelerates toward: the delayed command within the speed limits."""
        v_max, omega_max = self.limits.v_max, self.limits.omega_max
        return Velocity(
            min(max(self._v_target, -v_max), v_max), min(max(self._omega_target, -omega_max), omega_max)
        )

    @property
    def pose(self) -> Pose:
        """The true pose of the base in the bay's frame."""
        x, y = self.body.position
        return Pose(x, y, wrap_angle(self.body.angle))

    @property
    def velocity(self) -> Velocity:
        """The body's motion along the rover and its rotation; a stalled rover's is zero."""
        cos, sin = self.body.rotation_vector
        vx, vy = self.body.velocity
        return Velocity(cos * vx + sin * vy, self.body.angular_velocity)

    @property
    def in_contact(self) -> bool:
        """Whether the last substep found the rover touching something."""
        touching: list[bool] = []
        self.body.each_arbiter(lambda _arbiter: touching.append(True))
        return bool(touching)
