"""A robot's shape as a URDF for RViz, with the same frames as ``tf_static``. Pure functions.

Body and wheels are all in ``base_link``: the base does not report its wheel angles, so the wheels get no
joints, whose states a node would have to publish.
"""

import math
from xml.etree import ElementTree

from pydantic import BaseModel, Field

from bridge.ros2.messages import sensor_frames
from rover_ncp.robot.description import RobotDescription
from rover_ncp.wire.messages import BASE_FRAME

BODY, TYRE = "0.75 0.1 0.1 1", "0.1 0.1 0.1 1"
"""Colours as red, green, blue, opacity."""


class UrdfResult(BaseModel):
    """Result of the command ``urdf``."""

    model: str = Field(description="the robot's description, by name or file")
    urdf: str = Field(description="its text")


def urdf(robot: RobotDescription) -> str:
    """Return the XML text."""
    root = ElementTree.Element("robot", name=robot.name)
    base = ElementTree.SubElement(root, "link", name=BASE_FRAME)
    # The body is drawn between the wheels and from their axles up; the collision shape is the whole outline.
    middle = (robot.front_m - robot.rear_m) / 2
    axle = robot.wheels.radius_m
    between = 2 * min(abs(y) for _, y in robot.wheels.places) - robot.wheels.width_m
    height = robot.height_m - axle
    _box(base, "visual", (middle, 0.0, axle + height / 2), (robot.length_m, between, height))
    for x, y in robot.wheels.places:
        _wheel(base, (x, y, axle), robot)
    outline = (robot.length_m, robot.width_m, robot.height_m)
    _box(base, "collision", (middle, 0.0, robot.height_m / 2), outline)
    for frame in sensor_frames(robot):
        ElementTree.SubElement(root, "link", name=frame.child)
        joint = ElementTree.SubElement(root, "joint", name=f"{frame.child}_joint", type="fixed")
        ElementTree.SubElement(joint, "parent", link=frame.parent)
        ElementTree.SubElement(joint, "child", link=frame.child)
        _origin(joint, (frame.x, frame.y, frame.z), (0.0, 0.0, frame.yaw))
    ElementTree.indent(root)
    # Without an encoding: some readers of robot_description refuse one in what is text already.
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _box(link: ElementTree.Element, kind: str, centre: tuple[float, ...], size: tuple[float, ...]) -> None:
    part = ElementTree.SubElement(link, kind)
    _origin(part, centre, (0.0, 0.0, 0.0))
    geometry = ElementTree.SubElement(part, "geometry")
    ElementTree.SubElement(geometry, "box", size=_numbers(size))
    if kind == "visual":
        _colour(part, "body", BODY)


def _wheel(link: ElementTree.Element, centre: tuple[float, ...], robot: RobotDescription) -> None:
    part = ElementTree.SubElement(link, "visual")
    _origin(part, centre, (math.pi / 2, 0.0, 0.0))  # a cylinder's axis is z, a wheel's is y
    geometry = ElementTree.SubElement(part, "geometry")
    wheels = robot.wheels
    ElementTree.SubElement(
        geometry, "cylinder", radius=_numbers((wheels.radius_m,)), length=_numbers((wheels.width_m,))
    )
    _colour(part, "tyre", TYRE)


def _origin(of: ElementTree.Element, xyz: tuple[float, ...], rpy: tuple[float, ...]) -> None:
    ElementTree.SubElement(of, "origin", xyz=_numbers(xyz), rpy=_numbers(rpy))


def _colour(part: ElementTree.Element, name: str, rgba: str) -> None:
    ElementTree.SubElement(ElementTree.SubElement(part, "material", name=name), "color", rgba=rgba)


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.9g}" for value in values)
