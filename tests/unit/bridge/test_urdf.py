"""The URDF of each robot: well-formed, one tree, the frames of tf_static, the outline's size."""

import json
import math
from xml.etree import ElementTree

import pytest

from bridge.base import BaseReport
from bridge.pioneer.odometry import ROBOTS
from bridge.ros2 import messages as ros
from bridge.ros2.urdf import urdf
from rover_ncp import cli
from rover_ncp.wire.messages import decode

MODELS = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)


def numbers(text):
    return tuple(float(number) for number in text.split())


def origins(element):
    return [numbers(element.find("origin").get(name)) for name in ("xyz", "rpy")]


@MODELS
def test_frames_are_those_of_tf_static(robot):
    root = ElementTree.fromstring(urdf(robot))
    assert (root.tag, root.get("name")) == ("robot", robot.name)
    links = [link.get("name") for link in root.iter("link")]
    joints = {joint.find("child").get("link"): joint for joint in root.iter("joint")}
    assert sorted(links) == sorted({"base_link", *joints})  # one tree, whose root is the base
    sent = ros.each_second(BaseReport(), robot, 0)["tf_static"]
    transforms = decode("tf2_msgs/msg/TFMessage", sent).transforms
    assert len(transforms) == len(joints) == 16
    for item in transforms:
        joint = joints[item.child_frame_id]
        assert joint.get("type") == "fixed"
        assert joint.find("parent").get("link") == item.header.frame_id
        moved, turned = item.transform.translation, item.transform.rotation
        xyz, (roll, pitch, yaw) = origins(joint)
        assert xyz == pytest.approx((moved.x, moved.y, moved.z), abs=1e-8)
        assert (roll, pitch, turned.x, turned.y) == (0.0, 0.0, 0.0, 0.0)
        assert (math.sin(yaw / 2), math.cos(yaw / 2)) == pytest.approx((turned.z, turned.w), abs=1e-8)


@MODELS
def test_the_collision_box_is_the_outline_and_stands_on_the_ground(robot):
    (box,) = ElementTree.fromstring(urdf(robot)).iter("collision")
    size = numbers(box.find("geometry/box").get("size"))
    centre, _ = origins(box)
    assert size == pytest.approx((robot.length_m, robot.width_m, robot.height_m))
    assert centre[0] + size[0] / 2 == pytest.approx(robot.front_m)
    assert centre[0] - size[0] / 2 == pytest.approx(-robot.rear_m)
    assert (centre[1], centre[2] - size[2] / 2) == pytest.approx((0.0, 0.0))


@MODELS
def test_wheels_stand_on_the_ground_within_the_outline(robot):
    base = ElementTree.fromstring(urdf(robot)).find("link")
    wheels = [part for part in base.iter("visual") if part.find("geometry/cylinder") is not None]
    assert len(wheels) == (4 if robot.name.startswith("p3at") else 2)
    for wheel in wheels:
        cylinder = wheel.find("geometry/cylinder")
        radius, length = float(cylinder.get("radius")), float(cylinder.get("length"))
        (x, y, z), rpy = origins(wheel)
        assert z == radius
        assert rpy == pytest.approx((math.pi / 2, 0.0, 0.0))  # it rolls along x
        assert -robot.rear_m <= x - radius < x + radius <= robot.front_m
        assert abs(y) + length / 2 <= robot.width_m / 2


def test_urdf_command_prints_the_description(capsys):
    assert cli.run(["urdf", "p3dx"]) == 0
    assert capsys.readouterr().out == urdf(ROBOTS["p3dx"])
    assert cli.run(["urdf", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"model": "p3at-sh", "urdf": urdf(ROBOTS["p3at-sh"])}
    assert cli.run(["urdf", "hal"]) == 2
    assert capsys.readouterr().err.startswith(
        "rover-ncp: hal: no such file, and none of the shipped robots ("
    )
