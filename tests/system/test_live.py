"""A random trial as real processes, beside the same on a virtual clock."""

import json

import pytest
from json_fields import assert_on_page
from paths import DATA

from deploy.replay import replay
from rover_ncp.cli import run
from rover_ncp.recording.recording import read_recording
from rover_ncp.robot.profile import load_profile

pytestmark = pytest.mark.timed

SHORT = str(DATA / "short_course.yaml")


def test_live_and_virtual_trials_end_at_the_same_pose(tmp_path, capsys):
    out = tmp_path / "live"
    asked = ["--live", "1", "--stack", "--randomize", "full", "--seed", "4", "--course", SHORT]
    # The short course ends while the rover moves: the poses at that time are compared.
    assert run(["eval", "course", *asked, "--out", str(out), "--json"]) in {0, 1}
    fields = json.loads(capsys.readouterr().out)
    assert_on_page(fields, "eval --trials", "eval --trials --live, besides")
    trial = fields["live"][0]
    assert (fields["trials"], trial["trial"], trial["course"]) == (1, 0, "short")
    assert not trial["reason"].startswith("stopped by")
    # The rover still moves at 0.1 m/s then, so a delay of the last sample is a distance.
    assert fields["apart_m"]["max"] < 0.02
    assert fields["apart_rad"]["max"] < 0.05
    assert fields["bytes_to_base"] > 500
    recording = read_recording(out / "000" / "run.mcap")
    assert len(recording.topic("truth/pose")) > 400
    # The driver knew the noise of its odometry and its start pose, and nothing else.
    known = load_profile(out / "000" / "driver.yaml").model_dump(exclude_none=True)
    assert set(known) == {"format", "name", "noise_m", "noise_rad", "std", "measured"}
    assert known["std"] == {}
    assert recording.topic("pose")
    assert replay(out / "000" / "run.mcap").difference is None
    assert run(["eval", "course", *asked, "--out", str(out)]) == 2
    assert "is not an empty folder" in capsys.readouterr().err
