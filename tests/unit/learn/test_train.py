"""A training run on disk: what it holds, what it refuses, and that dying anywhere changes nothing."""

import csv
import fcntl
import os
import shlex
import shutil

import pytest
from kit.paths import DATA, content

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.errors import ConfigError, FileError, UsageError
from rover_ncp.course.course import load_course
from sim.learn.ensemble import train
from sim.learn.evaluator import Evaluator
from sim.learn.settings import TrainSettings

COURSE = DATA / "short_course.yaml"
SETTINGS = TrainSettings(course=str(COURSE), seed=1, agents=2, iterations=150)


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """A run without interruption."""
    out = tmp_path_factory.mktemp("reference") / "run"
    run(out)
    return out


def run(out, settings=SETTINGS, **options):
    return train(settings, out, processes=1, **options)


def test_the_policy_scores_what_its_provenance_says_to_the_last_bit(reference):
    course = load_course(COURSE)
    rows = list(csv.reader((reference / "curve.csv").read_text().splitlines()))
    for name, column in (("00", 1), ("01", 2)):
        policy = load_policy(reference / "agents" / f"{name}.yaml")
        score = Evaluator(policy, course).returns(policy.parameters()[None])[0]
        assert score == policy.provenance["return"] == float(rows[-1][column])
        assert policy.courses == ("short",)
    best = load_policy(reference / "policy.yaml")
    assert best.provenance["return"] == max(float(value) for value in rows[-1][1:])


def test_the_command_in_a_policy_makes_it_again(reference, tmp_path):
    command = shlex.split(load_policy(reference / "policy.yaml").provenance["command"])
    assert command[:2] == ["rover-ncp", "train"]
    options = dict(zip(command[2::2], command[3::2], strict=True))
    settings = TrainSettings.model_validate(
        {k.removeprefix("--"): v for k, v in options.items()}, strict=False
    )
    assert settings == SETTINGS
    run(tmp_path / "again", settings)
    assert content(tmp_path / "again") == content(reference)


@pytest.mark.parametrize(("processes", "block"), [(2, 1)])
def test_processes_and_company_change_nothing(reference, tmp_path, processes, block):
    train(SETTINGS, tmp_path / "run", processes=processes, block=block)
    assert content(tmp_path / "run") == content(reference)


def test_the_first_agent_that_is_accepted_ends_the_training(reference, tmp_path):
    seen = []
    found = run(tmp_path / "run", accept=lambda policy: bool(seen.append(policy)) or True)
    assert len(seen) == len(found.agents.agents) == 1
    first = load_policy(reference / "agents" / "00.yaml")
    assert found.policy.parameters().tolist() == first.parameters().tolist()
    assert load_policy(tmp_path / "run" / "policy.yaml").provenance["agent"] == 0
    assert not (tmp_path / "run" / "agents" / "01.json").exists()


def test_an_interrupted_run_keeps_the_blocks_that_have_ended(reference, tmp_path):
    def interrupt(ensemble):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "run", on_progress=interrupt, block=1)
    saved = (tmp_path / "run" / "agents" / "00.json").read_bytes()
    assert saved == (reference / "agents" / "00.json").read_bytes()
    assert load_policy(tmp_path / "run" / "policy.yaml").provenance["agent"] == 0
    trained = []
    run(tmp_path / "run", resume=True, accept=lambda policy: bool(trained.append(policy)))
    assert len(trained) == 1
    assert content(tmp_path / "run") == content(reference)


def test_a_folder_in_use_is_refused(reference):
    with pytest.raises(UsageError, match=r"holds a training run; go on with --resume, or choose"):
        run(reference)
    handle = os.open(reference, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        with pytest.raises(UsageError, match="another process is training in this folder"):
            run(reference, resume=True)
    finally:
        os.close(handle)


def test_a_course_that_changed_is_refused(tmp_path):
    course = tmp_path / "course.yaml"
    course.write_text(COURSE.read_text())
    settings = SETTINGS.model_copy(update={"course": str(course), "iterations": 1})
    run(tmp_path / "run", settings)
    run(tmp_path / "run", settings, resume=True)
    course.write_text(COURSE.read_text().replace("x: 0.3", "x: 0.31"))
    with pytest.raises(ConfigError, match=r"--course .*course.yaml: the file has changed"):
        run(tmp_path / "run", settings, resume=True)


def test_a_damaged_agent_is_rejected_by_name(reference, tmp_path):
    shutil.copytree(reference, tmp_path / "run")
    agent = tmp_path / "run" / "agents" / "00.json"
    agent.write_bytes(agent.read_bytes()[:200])
    with pytest.raises(FileError, match=r"00.json: not a state of this version; delete it"):
        run(tmp_path / "run", resume=True)


# -- curves ------------------------------------------------------------------------------------------------
