"""The ground a rover drives on, and what stands on it.

Obstacles are static: nothing in here can push them. Rovers pass through each other, because several of them
may share one bay only to be stepped together.
"""

from collections.abc import Sequence

import pymunk

from rover_ncp.core.course import Obstacle

COLLISION_SLOP_M = 0.001
"""How deep shapes may rest in each other. Chipmunk's default of 0.1 would be 10 cm in our metres."""

OBSTACLE_FRICTION = 0.5

ROVER_FILTER = pymunk.ShapeFilter(group=1)
"""Shapes of one group never collide with each other."""


class Bay:
    """A level piece of ground with obstacles (course frame, metres)."""

    def __init__(self, obstacles: Sequence[Obstacle] = ()) -> None:
        self.space = pymunk.Space()
        self.space.collision_slop = COLLISION_SLOP_M
        for obstacle in obstacles:
            self.add(obstacle)

    def add(self, obstacle: Obstacle) -> pymunk.Shape:
        """Put a rectangle into the bay and return its shape."""
        body = pymunk.Body(body_type=pymunk.Body.STATIC)
        body.position = (obstacle.x, obstacle.y)
        body.angle = obstacle.theta
        shape = pymunk.Poly.create_box(body, (obstacle.length, obstacle.width))
        shape.friction = OBSTACLE_FRICTION
        self.space.add(body, shape)
        return shape
