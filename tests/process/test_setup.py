"""``rover-ncp setup`` on a terminal, with mock robots: the file that it writes."""

import os
import pty
import select
import subprocess
import sys
import time

import pytest
from kit.described import described

from bridge.setup.find import pioneer_at
from rover_ncp import cli
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.errors import NoRobot
from rover_ncp.robot.robot_file import load_robot_file
from sim.park.live import Process

TURTLEBOT = "the floor"
"""In the question that measures the timeout of a TurtleBot 4, which must not stand on blocks."""


def answered(folder, answers, *options):
    """Run ``setup`` on a terminal; ``answers`` has words of questions. Return exit code and text."""
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "rover_ncp", "setup", *options]
    child = subprocess.Popen(
        command, cwd=folder, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True
    )
    os.close(theirs)
    text, asked, deadline_s = "", 0, time.monotonic() + 100
    try:
        while child.poll() is None and time.monotonic() < deadline_s:
            if select.select([ours], [], [], 0.1)[0]:
                try:
                    text += os.read(ours, 4096).decode()
                except OSError:  # the child closed it
                    break
            if text.endswith("] ") and len(text) > asked:
                answer = next((found for word, found in answers.items() if word in text[asked:]), "")
                asked = len(text)
                os.write(ours, f"{answer}\n".encode())
        return child.wait(10), text
    finally:
        child.kill()
        child.wait()
        os.close(ours)


def test_a_turtlebot_is_found_behind_its_router_and_measured(tmp_path):
    mock = ["--ros2", "--model", "turtlebot4", "--listen", "127.0.0.1:0"]
    with Process("mock", mock, tmp_path) as robot:
        router = robot.wait_for_line("listening on ")
        answers = {"Zenoh router": router, "halts by itself": "y", "wheels stand": "y"}
        answers["sees the tags"] = "http://127.0.0.1:8102/"
        code, text = answered(tmp_path, answers)
    assert code == 0, text
    assert TURTLEBOT in text
    settings = load_robot_file(tmp_path / "robot.yaml").settings
    assert (settings.base, settings.model) == (f"ros2/tcp/{router}", "turtlebot4")
    assert 0.3 < settings.measured_base_timeout_s < 1.5
    assert (settings.camera.source, settings.camera.file) == ("http://127.0.0.1:8102/", "camera.yaml")
    assert (tmp_path / f"{settings.tags}.pdf").exists()


@pytest.mark.parametrize(
    ("halts_s", "answers", "described_s", "left_s"),
    [
        (0.5, {}, None, 0.69),
        (0.5, {"halts by itself": "y", "wheels stand": "n"}, None, None),
        (None, {"halts by itself": "y"}, 0.5, None),
    ],
    ids=["not measured", "its wheels turned", "it drives on"],
)
def test_a_measured_timeout_that_a_new_measurement_refutes_leaves_the_file(
    tmp_path, halts_s, answers, described_s, left_s
):
    robot = described("turtlebot4", topics={"cmd_vel_timeout_s": halts_s})
    robot = robot.model_copy(update={"measured_base_timeout_s": described_s})
    model = tmp_path / "mine.yaml"
    model.write_text(dump_yaml(robot.model_dump(mode="json", exclude_none=True)))
    mock = ["--ros2", "--model", str(model), "--listen", "127.0.0.1:0"]
    with Process("mock", mock, tmp_path) as process:
        router = process.wait_for_line("listening on ")
        settings = {"base": f"ros2/tcp/{router}", "model": str(model), "measured_base_timeout_s": 0.69}
        (tmp_path / "robot.yaml").write_text(dump_yaml(settings))
        code, text = answered(tmp_path, {"sees the tags": "-"} | answers, "--overwrite")
    assert code == 0, text
    assert ("not checked; next" if left_s else "no driver may drive the robot") in text
    assert ("mine.yaml has a measured_base_timeout_s, which is wrong" in text) == (described_s is not None)
    assert load_robot_file(tmp_path / "robot.yaml").settings.measured_base_timeout_s == left_s


def test_a_pioneer_is_asked_for_its_name_and_left_as_it_was(tmp_path):
    with Process("mock", ["--listen", "127.0.0.1:0"], tmp_path) as mock:
        base = f"tcp/{mock.wait_for_line('listening on ')}"
        assert "p3at-sh" in pioneer_at(base)
        assert "p3at-sh" in pioneer_at(base)  # the line is free again
    with pytest.raises(NoRobot):
        pioneer_at(base)


def test_without_a_terminal_it_says_what_is_missing_and_asks_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.yaml").write_text("base: ros2/tcp/10.0.0.5\nmodel: turtlebot4\n")
    assert cli.run(["setup", "--overwrite"]) == 2
    assert "lacks camera, tags, measured_base_timeout_s" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["", "base: tcp/a\nlimits: {v_max: 0.2}\nplaces: here\nresume: true\n"])
def test_the_printed_file_has_the_same_settings(text, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    if text:
        (tmp_path / "robot.yaml").write_text(text)
    assert cli.run(["setup", "--print"]) == 0
    printed = capsys.readouterr().out
    before = load_robot_file(tmp_path / "robot.yaml").settings if text else None
    (tmp_path / "robot.yaml").write_text(printed if text else printed.replace("#base:", "base:"))
    after = load_robot_file(tmp_path / "robot.yaml").settings
    assert after == before or (not text and after.base == "tcp/127.0.0.1:8101")
