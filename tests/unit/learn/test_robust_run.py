"""A robust training on disk: the number of workers and dying anywhere change nothing."""

import pytest
from kit.paths import DATA, content

from rover_ncp.core.errors import FileError
from sim.learn.record import RobustSettings
from sim.learn.robust_run import train_robust
from sim.learn.workers import Inline

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


def test_workers_change_nothing(reference, tmp_path, monkeypatch):
    workers = Inline()
    workers.count = 3
    monkeypatch.setattr("sim.learn.robust_run.local_workers", lambda count: workers)
    train_robust(SETTINGS, tmp_path / "three")
    files = content(tmp_path / "three")
    assert sorted(files) == ["curve.csv", "policy.yaml", "search.json", "settings.yaml"]
    assert files == content(reference)


@pytest.mark.parametrize("writes", range(7))
def test_dying_before_any_write_changes_nothing(reference, tmp_path, dies, writes):
    assert dies(writes, lambda: train_robust(SETTINGS, tmp_path, processes=1))
    train_robust(SETTINGS, tmp_path, resume=(tmp_path / "settings.yaml").exists(), processes=1)
    assert content(tmp_path) == content(reference)


def test_a_damaged_search_is_refused(tmp_path):
    settings = SETTINGS.model_copy(update={"iterations": 1})
    train_robust(settings, tmp_path, processes=1)
    (tmp_path / "search.json").write_text('{"sha256": "0", "state": {"search": {}, "curve": []}}')
    with pytest.raises(FileError, match=r"search\.json: damaged"):
        train_robust(settings, tmp_path, resume=True, processes=1)


def test_resuming_needs_no_option_again(reference, run_json):
    before = content(reference)
    code, fields = run_json(f"train --out {reference} --resume")
    assert (code, fields["generations"]) == (0, 3)
    assert content(reference) == before
