"""What a camera sees of the tags of a place, for plans."""

import math

from deploy.place.place import Place
from deploy.place.sight import SeenTag, Sight
from deploy.tag.tag_map import CameraFile, Intrinsics, TagMap
from rover_ncp.core.geometry import same_frame


def sight_of(camera: CameraFile, tag_map: TagMap, place: Place) -> Sight | None:
    """Return the view of a camera on the rover, None if the map does not say where the place's tags are."""
    if tag_map.tags_on == "rover" or not same_frame(tag_map.frame, place.frame):
        return None
    edges = [[(float(x), float(y)) for x, y, _ in tag.corners[:2]] for tag in tag_map.tags]
    to_left, to_right = _view(camera.intrinsics)
    return Sight(
        x=camera.mount.x,
        y=camera.mount.y,
        yaw=camera.mount.yaw,
        to_left=to_left,
        to_right=to_right,
        tags=tuple(SeenTag(left=left, right=right) for left, right in edges),
    )


def _view(intrinsics: Intrinsics) -> tuple[float, float]:
    """Return the angles to the left and right edges of the picture, without a pinhole's distortion."""
    left, right = intrinsics.cx / intrinsics.fx, (intrinsics.cx - intrinsics.width + 1) / intrinsics.fx
    return (left, right) if intrinsics.model == "fisheye" else (math.atan(left), math.atan(right))
