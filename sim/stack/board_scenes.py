"""Rooms with a board at the place, for trials of docking with rendered pictures.

The place is taught as by ``place set``: the rover stands in it, and its camera sees the board. Nobody
measured the board's place, height and tilt. The driver knows the place in the board's frame alone.
"""

import math
from functools import cache
from typing import ClassVar

import numpy as np

from deploy.place.place import Place
from deploy.place.survey import set_place, survey
from deploy.tag.board import board_map
from deploy.tag.cameras.camera import Picture
from deploy.tag.localiser import Localiser
from deploy.tag.tag_map import Mount, Tag, TagMap
from rover_ncp.core.geometry import Pose, compose, relative
from rover_ncp.wire.messages import PoseSample
from sim.camera.render import Renderer
from sim.stack.rendered_camera import RenderedLocaliser, Scene, dock_camera
from sim.stack.tag_camera import camera_direction

NUMBER, OTHER_NUMBER, PAGE = 17, 18, "a4"
HEIGHT_M, LEAN_RAD = 0.35, math.radians(2.0)
"""Height of a board's middle, and how far it leans and hangs askew."""
TEACH_SEED, TEACH_PICTURES = 20, 40
WRONG = {"x": 0.014, "y": 0.014, "pitch": math.radians(2.0), "yaw": math.radians(2.0)}
"""What the camera's file has too much of its mount: 2 cm, and 2° about both axes."""


class BoardLocaliser(RenderedLocaliser):
    """A board at the place, and the camera of `park --dock`."""

    wrong: ClassVar[dict[str, float]] = {}
    """What the camera's file has too much of its mount."""
    beside: ClassVar[tuple[tuple[int, float], ...]] = ()
    """Other boards: their number, and how far they hang to the left."""
    roll = 0.0
    """How far the board was turned in its plane since the place was taught."""

    @classmethod
    def scene(cls, place: Place) -> Scene:
        """Return the room of the docking."""
        return cls._scene(place, cls.roll)

    @classmethod
    def taught(cls, place: Place) -> Place:
        """Return the place as ``place set`` stores it."""
        return _taught(cls, place)

    @classmethod
    def _scene(cls, place: Place, roll: float) -> Scene:
        camera, _ = dock_camera(place)
        tags = list(hung(place, cls.tags_ahead_m, NUMBER, 0.0, roll))
        for number, left_m in cls.beside:
            tags += hung(place, cls.tags_ahead_m, number, left_m)
        fields = camera.mount.model_dump()
        file = Mount(**{name: value + cls.wrong.get(name, 0.0) for name, value in fields.items()})
        # Another print of the board has the same ids.
        room = TagMap.model_construct(frame="room", tags_on="ground", tags=tuple(tags))
        return Scene(camera, room, camera.model_copy(update={"mount": file}), board_map(NUMBER, PAGE))


def hung(place: Place, ahead_m: float, number: int, left_m: float, roll: float = 0.0) -> tuple[Tag, ...]:
    """Return the tags of a board that hangs ahead of a docked base and faces it."""
    x, y, yaw = compose(compose(place.goal, camera_direction(place)), Pose(ahead_m, left_m, math.pi))
    board = Mount(x=x, y=y, z=HEIGHT_M, yaw=yaw, pitch=LEAN_RAD, roll=roll + LEAN_RAD)
    turned = board.model_dump(include={"yaw", "pitch", "roll"})
    tags = []
    for tag in board_map(number, PAGE).tags:
        at = dict(zip("xyz", (board.rotation @ tag.position + board.position).tolist(), strict=True))
        tags.append(tag.model_copy(update=at | turned))
    return tuple(tags)


@cache
def _taught(kind: type[BoardLocaliser], place: Place) -> Place:
    scene, stream = kind._scene(place, 0.0), np.random.default_rng(TEACH_SEED)
    renderer, localiser = Renderer(scene.camera, scene.tags, stream), Localiser(scene.camera_file, scene.map)
    samples = []
    for _ in range(TEACH_PICTURES):
        found = localiser.take(Picture(renderer.picture(place.goal), 0))
        if found is not None:
            samples.append(PoseSample(0, scene.map.frame, found.pose, found.covariance))
    seen = survey(samples, TEACH_PICTURES)
    obstacles = []
    for each in place.obstacles:
        moved = compose(seen.pose, relative(place.goal, Pose(each.x, each.y, each.theta)))
        obstacles.append(each.model_copy(update=moved._asdict()))
    return set_place(place.model_dump() | {"obstacles": obstacles}, seen, place.name)


class WrongMount(BoardLocaliser):
    """The camera's file is wrong, when the place is taught and at each docking."""

    wrong = WRONG


class SecondBoard(BoardLocaliser):
    """Another board hangs beside the board of the place."""

    beside = ((OTHER_NUMBER, 0.5),)


class SecondPrint(BoardLocaliser):
    """Another print of the same board hangs 3 m to the left."""

    beside = ((NUMBER, 3.0),)


class Sideways(BoardLocaliser):
    """The board was turned by 90° in its plane after the place was taught."""

    roll = math.pi / 2


SCENES: dict[str, type[RenderedLocaliser]] = {
    "tags": RenderedLocaliser,
    "board": BoardLocaliser,
    "wrong-mount": WrongMount,
    "second-board": SecondBoard,
    "second-print": SecondPrint,
    "sideways": Sideways,
}
