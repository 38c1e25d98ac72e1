"""A robust training on disk: the number of workers and dying anywhere change nothing."""

import pytest
import yaml
from kit.paths import DATA, content

from rover_ncp.core.config import dump_yaml
from rover_ncp.core.errors import ConfigError, FileError
from rover_ncp.core.files import resolve
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


def test_a_damaged_search_is_refused(tmp_path):
    settings = SETTINGS.model_copy(update={"iterations": 1})
    train_robust(settings, tmp_path, processes=1)
    (tmp_path / "search.json").write_text('{"sha256": "0", "state": {"search": {}, "curve": []}}')
    with pytest.raises(FileError, match=r"search\.json: not a state of this version"):
        train_robust(settings, tmp_path, resume=True, processes=1)


OWN = {
    "randomize": ("lost: 0.1", "lost: 0.2"),
    "profile": ("gain_v: 1.0", "gain_v: 0.8"),
    "model": ("motion: {accel: 0.3}", "motion: {accel: 0.2}"),
}
"""By setting: a key of its file, and the key after an edit."""
HEADS = {"randomize": "name: own\n", "profile": "name: own\n", "model": "name: own\nbased_on: p3at-sh\n"}


def own_run(folder, setting):
    """Train for one generation with an own file; return the file and a function that resumes the run."""
    path = folder / f"{setting}.yaml"
    path.write_text(f"{HEADS[setting]}{OWN[setting][0]}\n")
    settings = SETTINGS.model_copy(update={"iterations": 1, setting: str(path)})

    def go(resume):
        return train_robust(settings, folder / "run", resume=resume, processes=1)

    go(False)
    return path, lambda: go(True)


@pytest.mark.parametrize("setting", OWN)
def test_run_whose_file_changed_is_not_resumed(tmp_path, setting):
    path, resume = own_run(tmp_path, setting)
    before, text = content(tmp_path / "run"), path.read_text()
    path.write_text(f"# a remark\n{text}")
    resume()
    key, other = OWN[setting]
    path.write_text(text.replace(key, other))
    with pytest.raises(
        ConfigError, match=f"settings.yaml: --{setting} .*{setting}.yaml: the file has changed"
    ):
        resume()
    assert content(tmp_path / "run") == before
    path.write_text(text)
    resume()


def test_resuming_with_other_versions_is_a_warning_in_one_line(tmp_path, caplog):
    _, resume = own_run(tmp_path, "randomize")
    resume()
    assert caplog.messages == []
    record = tmp_path / "run" / "settings.yaml"
    saved = yaml.safe_load(record.read_text())
    saved["made_with"] |= {"numpy": "1.0\x1b", "numba": "0.1"}
    record.write_text(dump_yaml(saved))
    resume()
    (line,) = caplog.messages
    assert "the run began with numba 0.1, numpy 1.0\\x1b; its result" in line


def test_shipped_robot_is_recorded_without_its_sources(tmp_path):
    settings = SETTINGS.model_copy(update={"iterations": 1, "model": "p3dx"})
    train_robust(settings, tmp_path, processes=1)
    saved = yaml.safe_load((tmp_path / "settings.yaml").read_text())["model"]
    shipped = yaml.safe_load(resolve("robots", "p3dx").read_text())
    assert (saved["motion"]["accel"], "sources" in saved) == (shipped["motion"]["accel"], False)
