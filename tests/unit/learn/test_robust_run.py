"""A robust training on disk: the number of workers and dying anywhere change nothing."""

import pytest
from kit.paths import DATA, content

from sim.learn.robust import train_robust
from sim.learn.settings import RobustSettings

SETTINGS = RobustSettings(
    course=str(DATA / "short_course.yaml"),
    randomize="mild",
    seed=5,
    iterations=3,
    rollouts=4,
    worst=4,
    random_courses=0,
)


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """A run without interruption."""
    out = tmp_path_factory.mktemp("reference") / "run"
    train_robust(SETTINGS, out, processes=1)
    return out


def test_processes_change_nothing(reference, tmp_path):
    train_robust(SETTINGS, tmp_path / "two", processes=2)
    files = content(tmp_path / "two")
    assert sorted(files) == ["curve.csv", "policy.yaml", "search.json", "settings.yaml"]
    assert files == content(reference)


@pytest.mark.parametrize("writes", [0, 3, 6])
def test_dying_before_any_write_changes_nothing(reference, tmp_path, dies, writes):
    assert dies(writes, lambda: train_robust(SETTINGS, tmp_path, processes=1))
    train_robust(SETTINGS, tmp_path, resume=(tmp_path / "settings.yaml").exists(), processes=1)
    assert content(tmp_path) == content(reference)
