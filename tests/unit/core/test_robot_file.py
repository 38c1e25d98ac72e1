"""robot.yaml: what commands take from it, and what a mistake in it says."""

import pytest

from bridge.options import BridgeSettings, settings_for
from deploy.options import choose_robot
from rover_ncp import cli
from rover_ncp.core.errors import UsageError
from rover_ncp.wire.key_table import Role

TURTLEBOT = """
base: ros2/tcp/10.0.0.5
model: turtlebot4
measured_base_timeout_s: 0.62
limits: {v_max: 0.2}
keys: keys
namespace: bot1
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working folder, with a robot.yaml."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.yaml").write_text(TURTLEBOT)
    return tmp_path


def test_bridge_and_drivers_take_one_robot_from_the_file(folder):
    settings = settings_for(BridgeSettings(), None)
    chosen = settings.chosen()
    assert (chosen.address, chosen.description.measured_base_timeout_s) == ("ros2/tcp/10.0.0.5", 0.62)
    assert settings.gate_limits(chosen).v_max == 0.2
    robot = choose_robot(None, "", None, role=Role.VIEWER)
    assert robot.address.robot == settings.listen == "tcp/127.0.0.1:7449"
    assert (robot.address.namespace, settings.namespace) == ("bot1", "bot1")
    assert robot.described.name == "turtlebot4"
    files = [str(path) for path in (robot.address.zenoh_config, settings.zenoh_config)]
    assert files == ["keys/viewer.json5", "keys/bridge.json5"]


def test_an_option_overrides_the_file_and_an_address_takes_its_place(folder):
    other = choose_robot("robot.yaml", "bot2", None, model="husky-a200")
    assert (other.address.namespace, other.described.name) == ("bot2", "husky-a200")
    assert choose_robot("tcp/10.0.0.9", "", None).file is None


def test_what_was_measured_on_the_files_robot_does_not_hold_for_another(folder):
    other = settings_for(BridgeSettings(base="ros2/tcp/10.0.0.6"), "robot.yaml")
    assert other.chosen().description.measured_base_timeout_s is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("base: tcp/a\nbse: tcp/b\n", ["$.bse: unknown key", "expected base"]),
        ("base: serial//dev/ttyUSB0\nmeasured_base_timeout_s: 0.5\n", ["measured_base_timeout_s", "ROS 2"]),
        ("base: ros2/tcp/a\n", ["model is missing"]),
        ("page: 99999\n", ["$.page", "65535", "99999"]),
        ("name: mine\nbased_on: turtlebot4\n", ["description", "model: FILE"]),
        ("base: [\n", ["line 2"]),
    ],
)
def test_a_mistake_is_one_line_with_the_file_the_key_and_what_was_expected(folder, text, words, capsys):
    (folder / "robot.yaml").write_text(text)
    for command in (["check", "--on-blocks"], ["bridge"], ["tag", "run"]):
        assert cli.run(command) == 2
        printed = capsys.readouterr().err
        assert printed.count("\n") == 1
        assert "robot.yaml" in printed
        assert [word for word in words if word not in printed] == []


def test_two_files_an_unreadable_one_and_none_are_told_apart(folder, capsys):
    (folder / "robot.yml").write_text(TURTLEBOT)
    with pytest.raises(UsageError, match=r"robot\.yaml and robot\.yml are both in this folder"):
        choose_robot(None, "", None)
    for name in ("robot.yml", "robot.yaml"):
        (folder / name).unlink()
    with pytest.raises(UsageError, match="rover-ncp setup"):
        choose_robot(None, "", None)
    (folder / "robot.yaml").write_bytes(b"\xff\xfe\x00")
    assert cli.run(["check", "--on-blocks"]) == 2
    assert "robot.yaml" in capsys.readouterr().err


def test_inline_limits_wider_than_the_robots_name_their_key(folder):
    (folder / "robot.yaml").write_text(TURTLEBOT.replace("0.2}", "0.9}"))
    settings = settings_for(BridgeSettings(), None)
    with pytest.raises(UsageError, match=r"robot.yaml, \$\.limits: v_max is 0\.9"):
        settings.gate_limits(settings.chosen())
