"""Whole dockings with bad input: each ends defined, with the rover standing, and is never falsely docked."""

import math
from collections import deque
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pytest
from kit.virtual_docking import BEFORE_STAGING, STAGING, VirtualDocking, charging, place

from deploy.place.outcome import DockError
from deploy.tag.camera import Picture
from deploy.tag.localiser import Localiser
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import NoPose
from rover_ncp.core.geometry import Pose, distance, wrap_angle
from rover_ncp.course.course import Obstacle
from sim.camera.render import Renderer
from sim.stack.lines import WALL_NS
from sim.stack.rendered_camera import dock_camera

APPROACH_S = 8.0
"""A rover that starts at the staging pose is on its way then."""


class Camera:
    """The pose that rendered tags give. ``hang`` returns the tags as they really hang.

    From `APPROACH_S` on, ``gain`` multiplies the brightness, and a ``frozen`` camera repeats its picture.
    """

    def __init__(self, hang=lambda tags: tags, gain=1.0, frozen=False):
        camera, known = dock_camera(place())
        hung = known.model_copy(update={"tags": tuple(hang(known.tags))})
        self._renderer = Renderer(camera, hung, np.random.default_rng(2))
        self.localiser = Localiser(camera, known)
        self._gain, self._frozen = gain, frozen
        self._kept = deque(maxlen=1 if frozen else 2)
        """The pictures that a camera repeats which sees nothing new."""

    def __call__(self, pose, now):
        changed = now > APPROACH_S and (self._frozen or self._gain != 1.0)
        if changed and not self._frozen and self._renderer.gain == 1.0:
            self._renderer.gain = self._gain
            self._kept.extend(self._renderer.picture(Pose(*pose)) for _ in range(2))
        if changed:
            self._kept.rotate()
        else:
            self._kept.append(self._renderer.picture(Pose(*pose)))
        found = self.localiser.take(Picture(self._kept[-1], WALL_NS + round(now * NS_PER_S)))
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


def dock(ahead_m):
    """A wall that the front of a Pioneer 3-AT reaches so far ahead of the place."""
    return Obstacle(x=2.365 + ahead_m, y=1.0, length=0.1, width=0.6)


class Case(NamedTuple):
    """Bad input, what must be said about it, and the safety rule that stops the rover, if one does."""

    words: str
    stop: str | None = None
    error: DockError = DockError.FAILED_TO_CONTROL
    place: Mapping = MappingProxyType({})
    see: object = None
    start: Pose = STAGING
    obstacles: tuple = ()
    charge: bool | None = None


def tags(hang):
    """Tags that hang otherwise than the map says: the rover does not start."""
    return Case("no external pose", "no-pose", see=lambda: Camera(hang), start=BEFORE_STAGING)


UNCERTAIN = "within the tolerances with a probability of"
CASES = {
    "two tags hang elsewhere": tags(
        lambda t: [moved(t[0], y=t[0].y + 0.1), moved(t[1], y=t[1].y - 0.1), *t[2:]]
    ),
    "all tags are smaller": tags(lambda t: [moved(each, size=0.7 * each.size) for each in t]),
    "all tags have one id": tags(lambda t: [moved(each, id=t[0].id) for each in t]),
    "the camera is covered on the way": Case(UNCERTAIN, see=lambda: Camera(gain=0.0)),
    "the camera is over-exposed on the way": Case(UNCERTAIN, see=lambda: Camera(gain=12.0)),
    "the camera freezes on the way": Case(UNCERTAIN, see=lambda: Camera(frozen=True)),
    "the localiser dies early": Case(UNCERTAIN, see=lambda: lambda pose, now: pose if now < 4.0 else None),
    "the camera lags 1.5 s": Case(
        "5 external poses rejected", "external-pose", see=lambda: late(1.5), start=BEFORE_STAGING
    ),
    # Late poses make the estimate wrong; which rule ends the drive first depends on the lag.
    "the camera lags 2 s": Case(
        "external poses rejected", "external-pose", see=lambda: late(2.0), start=BEFORE_STAGING
    ),
    "poses jump by 0.5 m on the way": Case(
        "5 external poses rejected",
        "external-pose",
        see=lambda: lambda pose, now: pose._replace(y=pose.y + (0.5 if now > APPROACH_S else 0.0)),
    ),
    "the place is out of reach": Case(
        "4.30 m from the staging pose (at most 3 m)",
        "start-pose",
        start=Pose(-3.0, 1.0, 0.0),
        error=DockError.FAILED_TO_STAGE,
    ),
    "a wall stands before the place": Case(
        "touches obstacle 1",
        "start-pose",
        start=BEFORE_STAGING,
        place={"obstacles": [{"x": 1.3, "y": 1.0, "length": 0.1, "width": 4.0}]},
    ),
    "somebody stands in the approach": Case("contact ", obstacles=(dock(-0.215),)),
    "the dock was moved 10 cm nearer": Case("contact ", obstacles=(dock(-0.1),)),
    "no charge flows": Case(
        "no charge within 25 s", error=DockError.FAILED_TO_CHARGE, place={"proof": "charging"}, charge=False
    ),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_bad_input_has_a_defined_end(case):
    where = place(retries=0, **case.place)
    see = {} if case.see is None else {"see": case.see()}
    drive = VirtualDocking(where, case.start, obstacles=case.obstacles, **see)
    if case.charge is not None:
        charging(drive, case.charge)
    if case.stop == "no-pose":
        with pytest.raises(NoPose, match=case.words):
            drive.run()
        assert drive.rover.pose == pytest.approx(case.start, abs=1e-3)
        return
    result = drive.run()
    assert case.words in result.reason
    assert (result.dock.success, result.stopped_by, drive.stands()) == (False, case.stop, True)
    assert drive.link.released_ns is not None
    if case.stop in {None, "start-pose"}:
        assert result.dock.error_code == case.error
    if case.stop is None:
        assert (result.exit_code, result.dock.at) == (1, "staging pose")
        there, staging = drive.rover.pose, where.staging
        assert distance(there, staging) < 0.12
        assert abs(wrap_angle(there.theta - staging.theta)) < math.radians(12.0)
