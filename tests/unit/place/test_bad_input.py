"""Whole dockings with bad input: each ends defined, with the rover standing, and is never falsely docked."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
import pytest
from kit.virtual_docking import BEFORE_STAGING, STAGING, VirtualDocking, place

from deploy.place.outcome import DockError
from deploy.tag.cameras.camera import Picture
from deploy.tag.localiser import Localiser
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.geometry import Pose, distance, wrap_angle
from rover_ncp.course.course import Obstacle
from sim.camera.render import Renderer
from sim.stack.lines import WALL_NS
from sim.stack.rendered_camera import dock_camera

APPROACH_S = 8.0
"""A rover that starts at the staging pose is on its way then."""


class Camera:
    """The pose that rendered tags give. ``hang`` returns the tags as they really hang.

    From `APPROACH_S` on, a ``covered`` camera sees nothing but its noise.
    """

    def __init__(self, hang=lambda tags: tags, covered=False):
        camera, known = dock_camera(place())
        hung = known.model_copy(update={"tags": tuple(hang(known.tags))})
        self._renderer = Renderer(camera, hung, np.random.default_rng(2))
        self.localiser, self._covered = Localiser(camera, known), covered

    def __call__(self, pose, now):
        if self._covered and now > APPROACH_S:
            self._renderer.gain = 0.0
        picture = Picture(self._renderer.picture(Pose(*pose)), WALL_NS + round(now * NS_PER_S))
        found = self.localiser.take(picture)
        return found and found.pose


def late(seconds):
    """A camera whose pictures arrive late, with the stamps of their arrival."""
    seen = deque()

    def see(pose, now):
        seen.append((now, pose))
        while len(seen) > 1 and seen[1][0] <= now - seconds:
            seen.popleft()
        return seen[0][1]

    return see


def moved(tag, **changes):
    """A tag that is otherwise than the map says."""
    return tag.model_copy(update=changes)


DOCK = Obstacle(x=2.265, y=1.0, length=0.1, width=0.6)
"""A wall that the front of a Pioneer 3-AT reaches 10 cm before the place."""


class Case(NamedTuple):
    """Bad input, what must be said about it, and the safety rule that stops the rover, if one does."""

    words: str
    stop: str | None = None
    see: object = lambda: lambda pose, now: pose
    start: Pose = STAGING
    obstacles: tuple = ()


def tags(hang):
    """Tags that hang otherwise than the map says: the rover looks for them and does not start."""
    return Case("no external pose", "start-pose", lambda: Camera(hang), BEFORE_STAGING)


CASES = {
    "two tags hang elsewhere": tags(
        lambda t: [moved(t[0], y=t[0].y + 0.1), moved(t[1], y=t[1].y - 0.1), *t[2:]]
    ),
    "all tags have one id": tags(lambda t: [moved(each, id=t[0].id) for each in t]),
    "the camera is covered on the way": Case(
        "within the tolerances with a probability of", see=lambda: Camera(covered=True)
    ),
    "the camera lags 1.5 s": Case(
        "5 external poses rejected", "external-pose", lambda: late(1.5), BEFORE_STAGING
    ),
    "poses jump by 0.5 m on the way": Case(
        "5 external poses rejected",
        "external-pose",
        lambda: lambda pose, now: pose._replace(y=pose.y + (0.5 if now > APPROACH_S else 0.0)),
    ),
    "the dock was moved 10 cm nearer": Case("contact ", obstacles=(DOCK,)),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_bad_input_has_a_defined_end(case):
    where = place(retries=0)
    drive = VirtualDocking(where, case.start, obstacles=case.obstacles, see=case.see())
    result = drive.run()
    assert case.words in result.reason
    if case.stop == "start-pose":
        assert (result.exit_code, result.dock.error_code) == (4, DockError.FAILED_TO_DETECT_DOCK)
        assert distance(drive.rover.pose, case.start) < 0.05
    assert (result.dock.success, result.stopped_by, drive.stands()) == (False, case.stop, True)
    assert drive.link.released_ns is not None
    if case.stop is None:
        assert (result.exit_code, result.dock.at) == (1, "staging pose")
        assert result.dock.error_code == DockError.FAILED_TO_CONTROL
        there, staging = drive.rover.pose, where.staging
        assert distance(there, staging) < 0.12
        assert abs(wrap_angle(there.theta - staging.theta)) < math.radians(12.0)
