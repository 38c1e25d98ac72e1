"""The command ``course``."""

import json

import pytest

from rover_ncp import cli
from rover_ncp.course.course import load_course


def test_new_makes_a_course_that_check_finds_drivable(tmp_path, capsys):
    poses = tmp_path / "poses.csv"
    poses.write_text("x,y,theta\n1.0,1.0,1.5708\n1.0,1.6,1.5708\n")
    out = tmp_path / "My bay!.yaml"
    assert cli.run(["course", "new", str(poses), "--out", str(out), "--json"]) == 0
    fields = json.loads(capsys.readouterr().out)
    assert fields["drivable"]
    assert fields["problems"] == []
    assert fields["out"] == str(out)
    assert load_course(out).name == fields["course"] == "my-bay"
    assert load_course(out).goal == pytest.approx((0.6, 0.0, 0.0), abs=1e-4)

    picture = tmp_path / "course.png"
    assert cli.run(["course", "check", str(out), "--out", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "my-bay: drivable" in capsys.readouterr().out


def test_what_cannot_be_driven_is_exit_1_and_says_where_and_why(tmp_path, capsys):
    (tmp_path / "aside.csv").write_text("x,y,theta\n0,0,0\n0,0.5,0\n")
    out = tmp_path / "aside.yaml"
    assert cli.run(["course", "new", str(tmp_path / "aside.csv"), "--out", str(out)]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "aside: not drivable" in said
    assert "sideways: 0.50 m to the left" in said
    assert cli.run(["course", "check", str(out), "--json", "--out", str(tmp_path / "aside.png")]) == 1
    fields = json.loads(capsys.readouterr().out)
    assert not fields["drivable"]
    assert {problem["cause"] for problem in fields["problems"]} == {"sideways"}
    assert fields["problems"][0]["checkpoint"] == 3
    assert (tmp_path / "aside.png").stat().st_size > 10_000
