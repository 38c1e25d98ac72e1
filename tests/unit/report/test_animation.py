"""The animated picture of a drive."""

import io

import numpy as np
import pytest
from paths import DATA
from PIL import Image
from recorded_drives import write_drive

from rover_ncp.core.errors import UsageError
from sim.explain.report import write_animation


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_an_animation_shows_the_drive_from_its_start_to_its_end_again_and_again(suffix, tmp_path):
    run = write_drive(tmp_path / "run.mcap", "course", DATA / "short_course.yaml")
    out = tmp_path / f"drive{suffix}"
    write_animation(tmp_path / "run.mcap", out)
    picture = Image.open(io.BytesIO(out.read_bytes()))
    assert picture.info["loop"] == 0
    assert picture.n_frames > len(run.commands) / 8
    first = np.asarray(picture.convert("L"), float)
    picture.seek(picture.n_frames - 1)
    last = np.asarray(picture.convert("L"), float)
    changed = np.abs(first - last).max(axis=0) > 40
    half = changed.size // 2
    assert changed[:half].any()  # the rover moved
    assert changed[half:].any()  # potentials changed


def test_another_format_is_refused(tmp_path):
    with pytest.raises(UsageError, match=r"ends in \.gif or \.webp"):
        write_animation(tmp_path / "run.mcap", tmp_path / "drive.mp4")
