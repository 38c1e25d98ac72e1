"""Courses made from poses and from recorded drives."""

from dataclasses import replace

import numpy as np
import pytest

from rover_ncp.core.config import parse_yaml
from rover_ncp.core.errors import ConfigError, FileError
from rover_ncp.core.geometry import Pose, Velocity, compose, distance, relative
from rover_ncp.course.builder import CoursePose, PoseList, course_yaml, make_course, read_poses
from rover_ncp.course.course import Course
from rover_ncp.course.reference import drive_profile
from rover_ncp.recording.recording import Recorded, RecordingWriter, read_recording
from rover_ncp.wire.messages import odometry

START = Pose(2.0, -1.0, 2.5)


def places(*poses, obstacles=()):
    return PoseList(poses=tuple(CoursePose(x=x, y=y, theta=t) for x, y, t in poses), obstacles=obstacles)


def test_deadlines_can_be_met_and_the_first_pose_is_the_origin():
    there = [Pose(0, 0, 0), Pose(0.5, 0.1, 0.4), Pose(0.9, 0.5, 1.0)]
    course, found = make_course("mine", "mine.csv", places(*(compose(START, pose) for pose in there)))
    assert found.drivable, found.problems
    assert course.checkpoints[0].pose == (0, 0, 0)
    driven = [point.pose for point in course.checkpoints[1:-1]]
    for pose, wanted in zip(driven, there, strict=True):
        assert pose == pytest.approx(wanted, abs=1e-4)
    assert course.checkpoints[-1].pose == course.checkpoints[-2].pose
    assert course.start_signal_s == course.checkpoints[1].t == 3.0
    assert parse_yaml(course_yaml(course), Course, "its own file") == course


def test_obstacles_come_along():
    text = (
        "poses:\n- {x: 2, y: 1, theta: 1.5707963}\n- {x: 2, y: 2, theta: 1.5707963}\n"
        "obstacles:\n- {x: 2, y: 2.6, theta: 1.5707963, length: 0.2, width: 0.5}\n"
    )
    course, found = make_course("wall", "wall.yaml", parse_yaml(text, PoseList, "wall.yaml"))
    (wall,) = course.obstacles
    assert (wall.x, wall.y, wall.theta) == pytest.approx((1.6, 0.0, 0.0), abs=1e-6)
    assert found.drivable
    assert found.clearance_m == pytest.approx(1.6 - 0.1 - 1.0 - 0.313, abs=0.003)


def recording(path, stretches, start=START, rate=10):
    """A drive of (seconds, v, omega), from rest to rest, as odometry."""
    v, omega = [0.0] * 20, [0.0] * 20
    for seconds, speed, turn in stretches:
        v += [speed] * round(seconds * rate)
        omega += [turn] * round(seconds * rate)
    v, omega = v + [0.0] * 20, omega + [0.0] * 20
    poses = drive_profile(start, v, omega).poses
    with RecordingWriter(path) as writer:
        for k, pose in enumerate(poses):
            ns = 10**18 + k * 10**8
            data = odometry(Pose(*pose), Velocity(v[k], omega[k]), ns)
            writer.write(Recorded("odom", "nav_msgs/msg/Odometry", data, ns, ns))
    return poses


def test_a_recorded_drive_becomes_a_course_along_the_same_way(tmp_path):
    # Faster than the motors of the circuits, with a pause: neither is of consequence.
    way = recording(tmp_path / "run.mcap", [(3, 0.25, 0.0), (5, 0.0, 0.0), (5, 0.12, 0.16)])
    course, found = make_course("again", "run.mcap", read_poses(tmp_path / "run.mcap"))
    assert found.drivable, found.problems
    own = [relative(START, Pose(*pose)) for pose in way]
    assert distance(course.goal, own[-1]) < 0.01
    steps = np.array([min(distance(Pose(*pose), other) for other in own) for pose in found.reference.poses])
    assert steps.max() < 0.03
    assert course.horizon_s < 40


@pytest.mark.parametrize(
    ("name", "content", "error", "words"),
    [
        ("a.csv", "x,y\n1,2\n", FileError, "lacks theta"),
        ("a.csv", "x,y,theta\n1,2,3\n", FileError, "two poses at least, got 1"),
        (
            "a.yaml",
            "poses:\n- {x: 0, y: 0, theta: 0}\n- {x: 1, y: 0, theta: 90}\n",
            ConfigError,
            r"a\.yaml: \$\.poses\[1\]\.theta: an angle is in radians, from -2π to 2π, got 90$",
        ),
        (
            "a.csv",
            "x;y;theta\n1,500;2;0.5\n2;2;0\n",  # a comma of thousands?
            FileError,
            "line 2: .*all with a decimal comma; got '1,500, 2, 0.5'",
        ),
        ("a.mcap", "nothing", FileError, "not an MCAP recording"),
    ],
)
def test_a_file_that_is_no_list_of_poses_is_named(tmp_path, name, content, error, words):
    (tmp_path / name).write_text(content)
    with pytest.raises(error, match=words):
        read_poses(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "sep=;\nx;y;theta\n0;0;0\n0,4;0,1;0,3\n;;\n"),
        ("A.YML", "poses: [{x: 0, y: 0, theta: 0}, {x: 0.4, y: 0.1, theta: 0.3}]\n"),
    ],
)
def test_what_spreadsheets_and_people_add_changes_no_pose(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    assert read_poses(tmp_path / name) == places((0.0, 0.0, 0.0), (0.4, 0.1, 0.3))


def test_poses_of_a_recording_are_found_by_their_type(tmp_path):
    recording(tmp_path / "run.mcap", [(5, 0.12, 0.1)])
    own, messages = read_poses(tmp_path / "run.mcap"), read_recording(tmp_path / "run.mcap").messages
    bags = (["/odom"], ["/r/odom"], ["/odometry/filtered"], ["/odom", "/odometry/wheels"])
    for number, topics in enumerate(bags):
        assert read_poses(bag(tmp_path / f"{number}.MCAP", messages, topics)) == own
    with pytest.raises(FileError, match=r"several topics of nav_msgs/msg/Odometry \(/a, /b\)"):
        read_poses(bag(tmp_path / "two.mcap", messages, ["/a", "/b"]))


def bag(path, messages, topics):
    """Write messages once for each topic, and return the path."""
    with RecordingWriter(path) as writer:
        for message in messages:
            for topic in topics:
                writer.write(replace(message, topic=topic))
    return path
