"""The command ``place`` beside a process that publishes poses, in each form that ROS sends them."""

import numpy as np
import pytest
from kit.zenoh_session import open_router, repeating

from bridge.ros2.rmw import Topic
from deploy.place.place import load_place
from rover_ncp import cli
from rover_ncp.core.geometry import Pose
from rover_ncp.wire.messages import POSE_STAMPED, pose_stamped, pose_with_covariance

DOCKED = Pose(2.0, 1.0, 3.1)


@pytest.fixture
def publish():
    """Return a function that publishes poses on a key until the test ends, and the address to reach it."""
    session, address = open_router()
    with repeating(session, 0.02) as start:

        def publish(key, data):
            start(lambda number: session.put(key, data))
            return address

        yield publish


@pytest.mark.parametrize(
    ("key", "data"),
    [
        ("pose", pose_with_covariance(DOCKED, np.eye(3) * 1e-5, 0, "map")),
        (Topic("pose", POSE_STAMPED).key(7), pose_stamped(DOCKED, 0, "map")),
    ],
    ids=["with covariance", "rmw_zenoh"],
)
def test_place_set_stores_what_is_seen_and_check_finds_it(
    publish, key, data, tmp_path, monkeypatch, run_json
):
    monkeypatch.chdir(tmp_path)
    options = f"charger --robot {publish(key, data)} --seconds 1"
    assert run_json(f"place set {options} --direction backward")[0] == 0
    made = load_place("charger")
    assert (made.name, made.frame, made.backward) == ("charger", "map", True)
    assert made.goal == pytest.approx(DOCKED)
    assert made.scatter.poses >= 10
    assert run_json(f"place check {options}")[0] == 0
    moved = (tmp_path / "charger.yaml").read_text().replace("y: 1.0", "y: 1.05")
    (tmp_path / "charger.yaml").write_text(moved)
    code, checked = run_json(f"place check {options}")
    assert (code, checked["fits"]) == (1, False)


def test_place_set_without_poses_says_so_and_keeps_the_file(publish, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    command = ["place", "set", "charger", "--seconds", "1", "--robot", publish("odom", b"")]
    assert cli.run(command) == 3
    assert "0 external poses arrived on 'pose' in 1 s" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
