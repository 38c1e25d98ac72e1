"""One rover on pymunk, and the ground that it drives on."""

import math
from collections.abc import Sequence

import pymunk

from rover_ncp.core.errors import ConfigError
from rover_ncp.core.geometry import ORIGIN, Pose, Velocity, wrap_angle
from rover_ncp.course.course import Course, Obstacle
from sim.world.rover import GRAVITY_M_S2, SUBSTEP_S, Rover, RoverModel, own_axes, toward

COLLISION_SLOP_M = 0.001
"""How deep shapes may rest in each other. Chipmunk's default of 0.1 would be 10 cm in our metres."""
OBSTACLE_FRICTION = 0.5
_ROVERS = pymunk.ShapeFilter(group=1)
"""Shapes of one group never collide with each other."""


class Ground:
    """Level ground with obstacles (course frame, metres), which are static: nothing can push them.

    Rovers pass through each other: several of them may share one ground only to be stepped together.
    """

    def __init__(self, obstacles: Sequence[Obstacle] = ()) -> None:
        self.space = pymunk.Space()
        self.space.collision_slop = COLLISION_SLOP_M
        self.is_free = True
        """Whether there is no obstacle: no ray hits anything."""
        for obstacle in obstacles:
            self.add(obstacle)

    def add(self, obstacle: Obstacle) -> pymunk.Shape:
        """Put a rectangle onto the ground and return its shape."""
        self.is_free = False
        body = pymunk.Body(body_type=pymunk.Body.STATIC)
        body.position = (obstacle.x, obstacle.y)
        body.angle = obstacle.theta
        shape = pymunk.Poly.create_box(body, (obstacle.length, obstacle.width))
        shape.friction = OBSTACLE_FRICTION
        self.space.add(body, shape)
        return shape


def rover_body(
    model: RoverModel, ground: Ground, pose: Pose = ORIGIN, *, has_shape: bool = True
) -> pymunk.Body:
    """Put a rover's body onto the ground, standing still; without a shape it touches nothing."""
    size = (model.length, model.width)
    body = pymunk.Body(model.mass, pymunk.moment_for_box(model.mass, size))
    body.position, body.angle = (pose.x, pose.y), pose.theta
    ground.space.add(body)
    if has_shape:
        shape = pymunk.Poly.create_box(body, size)
        shape.filter = _ROVERS
        shape.friction = model.shell_friction
        ground.space.add(shape)
    return body


def require_free_start(model: RoverModel, course: Course) -> None:
    """Raise ConfigError when the rover stands in an obstacle at the start of a course, the origin."""
    ground = Ground(course.obstacles)
    body = rover_body(model, ground)
    if any(ground.space.shape_query(shape) for shape in body.shapes):
        size = f"{model.length} m by {model.width} m"
        raise ConfigError(f"course {course.name}", [f"an obstacle stands where the rover starts ({size})"])


class PymunkRover(Rover):
    """A rover alone on its ground."""

    def __init__(self, model: RoverModel, ground: Ground, pose: Pose = ORIGIN) -> None:
        super().__init__(model)
        self.ground, self.body = ground, rover_body(model, ground, pose)

    def set_pose(self, pose: Pose) -> None:
        # A new body, because the old one would carry the last contact's correction into its next step.
        self.ground.space.remove(self.body, *self.body.shapes)
        self.body = rover_body(self.model, self.ground, pose)
        self.commands.clear()

    def push(self, shift: Pose) -> None:
        x, y = self.body.position
        self.body.position = (x + shift.x, y + shift.y)
        self.body.angle += shift.theta

    def substep(self) -> None:
        self._accelerate(self.commands.begin_substep())
        self.ground.space.step(SUBSTEP_S)

    def _accelerate(self, target: Velocity) -> None:
        limits, body = self.commands.limits, self.body
        cos, sin = body.rotation_vector
        forward, sideways = own_axes(cos, sin, *body.velocity, body.angular_velocity)
        forward = toward(forward, target.v, limits.accel * SUBSTEP_S, limits.decel * SUBSTEP_S)
        grip = self.model.friction * GRAVITY_M_S2 * SUBSTEP_S
        gain = self.model.turn_gain
        rise, fall = limits.alpha * SUBSTEP_S * gain, limits.alpha_decel * SUBSTEP_S * gain
        omega = toward(body.angular_velocity, target.omega * gain, rise, fall)
        sideways = toward(sideways, self.model.rotation_center_m * omega, grip, grip)
        body.velocity = (cos * forward - sin * sideways, sin * forward + cos * sideways)
        body.angular_velocity = omega

    def range_along(self, ray: Pose, most_m: float) -> float | None:
        if self.ground.is_free:
            return None
        end = (ray.x + most_m * math.cos(ray.theta), ray.y + most_m * math.sin(ray.theta))
        hit = self.ground.space.segment_query_first((ray.x, ray.y), end, 0.0, _ROVERS)
        return None if hit is None else hit.alpha * most_m

    @property
    def pose(self) -> Pose:
        x, y = self.body.position
        return Pose(x, y, wrap_angle(self.body.angle))

    @property
    def turned(self) -> float:
        return self.body.angle

    @property
    def velocity(self) -> Velocity:
        cos, sin = self.body.rotation_vector
        vx, vy = self.body.velocity
        return Velocity(cos * vx + sin * vy, self.body.angular_velocity)

    @property
    def encoders(self) -> Velocity:
        body = self.body
        forward, _ = own_axes(*body.rotation_vector, *body.velocity, body.angular_velocity)
        return Velocity(forward, body.angular_velocity / self.model.turn_gain)

    @property
    def in_contact(self) -> bool:
        touching: list[bool] = []
        self.body.each_arbiter(lambda _arbiter: touching.append(True))
        return bool(touching)
