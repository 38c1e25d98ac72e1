"""The train command: what it prints, what it refuses, and real processes that are interrupted and killed."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from kit.folders import content
from kit.json_fields import assert_on_page
from kit.paths import DATA

from rover_ncp.circuit.policy_file import load_policy, policy_to_yaml
from rover_ncp.cli import run
from rover_ncp.core.config import dump_yaml
from rover_ncp.course.course import load_course
from sim.learn.engine.evaluator import Evaluator
from sim.learn.progress import TrainProgress
from sim.live.processes import wait_for

pytestmark = pytest.mark.usefixtures("no_git")

COURSE = DATA / "short_course.yaml"
TRAIN = ["train", "--course", str(COURSE), "--agents", "2", "--seed", "11", "--iterations", "500"]
QUICK = ["train", "--course", str(COURSE), "--agents", "2", "--iterations", "20", "--processes", "1"]
# A commit during the tests would change the record; without git on the path it names no commit.
NO_GIT = {**os.environ, "PATH": ""}


def start(*arguments):
    command = [sys.executable, "-c", "from rover_ncp.entry import main; main()", *arguments]
    return subprocess.Popen(
        command,
        env=NO_GIT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def children(pid):
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except FileNotFoundError:
        return []


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


# -- what it prints ----------------------------------------------------------------------------------------


def test_json_is_one_object_with_the_documented_fields(tmp_path, capfd):
    out = tmp_path / "run"
    assert run([*QUICK, "--seed", "4", "--out", str(out), "--json"]) == 0
    printed = capfd.readouterr()
    fields = json.loads(printed.out)
    assert printed.out.count("\n") == 1
    assert "\x1b" not in printed.err
    assert_on_page(fields, "train")
    assert (fields["seed"], fields["agents"], fields["iterations"]) == (4, 2, 20)
    assert fields["best_return"] == max(fields["returns"])
    assert fields["median_return"] == pytest.approx(sum(fields["returns"]) / 2)
    assert fields["iterations_per_s"] > 0
    assert 0 < fields["wall_s"] < 120
    policy = load_policy(fields["policy"])
    score = Evaluator(policy, load_course(COURSE)).returns(policy.parameters()[None])[0]
    assert score == fields["best_return"]


def test_people_read_the_return_and_where_the_policy_is(tmp_path, capfd):
    assert run([*QUICK, "--out", str(tmp_path / "run")]) == 0
    text = capfd.readouterr().out
    assert text.startswith("best of 2 agents: return -")
    assert str(tmp_path / "run" / "policy.yaml") in text


def test_runs_without_a_folder_are_numbered_and_typos_leave_none(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert run(["train", "--course", "prking"]) == 2
    assert not (tmp_path / "runs").exists()
    for number in (1, 2):
        capfd.readouterr()
        assert run([*QUICK, "--json"]) == 0
        assert json.loads(capfd.readouterr().out)["out"] == f"runs/train-{number}"
    assert content(Path("runs/train-1")) == content(Path("runs/train-2"))


def test_resume_needs_no_options_and_refuses_others(tmp_path, capfd):
    out = str(tmp_path / "run")
    assert run([*QUICK, "--out", out]) == 0
    before = content(tmp_path)
    assert run(["train", "--out", out, "--resume"]) == 0
    assert content(tmp_path) == before
    assert run(["train", "--out", out, "--resume", "--seed", "9", "--agents", "2"]) == 2
    assert "--seed was 0 when this run began, now 9" in capfd.readouterr().err
    assert content(tmp_path) == before


def test_a_terminal_shows_the_best_return(monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    assert run([*QUICK, "--out", str(tmp_path / "run")]) == 0
    printed = capsys.readouterr()
    best = load_policy(tmp_path / "run" / "policy.yaml").provenance["return"]
    assert f"best {best:.4f}" in printed.err
    assert "20/20" in printed.err
    monkeypatch.delenv("FORCE_COLOR")
    with TrainProgress(20):
        pass
    assert capsys.readouterr().err == ""


# -- what it refuses ---------------------------------------------------------------------------------------


# -- interrupted and killed --------------------------------------------------------------------------------


@pytest.mark.parametrize("moment", ["settings.yaml", "agents/01.json"])
def test_ctrl_c_ends_cleanly_with_130_and_a_state_to_resume(tmp_path, moment):
    """Ctrl-C reaches the whole process group, as from a terminal: while the workers start, and at work."""
    out = tmp_path / "run"
    process = start(*TRAIN[:-1], "1000000", "--out", str(out), "--processes", "2", "--json")
    try:
        wait_for((out / moment).exists, 60.0)
        workers = children(process.pid)
        os.killpg(process.pid, signal.SIGINT)
        printed, errors = process.communicate(timeout=30)
    finally:
        process.kill()
    assert process.returncode == 130
    assert json.loads(printed)["exit_code"] == 130
    assert f"--out {out} --resume" in errors
    assert errors.endswith("rover-ncp: interrupted\n")
    assert "Traceback" not in errors
    wait_for(lambda: not any(is_running(pid) for pid in workers), 10)
    if moment != "settings.yaml":
        iterations = load_policy(out / "policy.yaml").provenance["settings"]["iterations"]
        assert (out / "curve.csv").read_text().splitlines()[-1].startswith(f"{iterations},")
        assert not list(out.rglob(".*"))


# A file that exists, or the iterations that are saved: while the workers start, at work, and at the end.
MOMENTS = ["settings.yaml", 0, 100, 200, 500, "agents/01.yaml", "curve.png"]


def reached(out, moment):
    """Whether a run has come to a moment."""
    if isinstance(moment, str):
        return (out / moment).exists()
    table = out / "curve.csv"
    return table.exists() and int(table.read_text().splitlines()[-1].split(",")[0]) >= moment


@pytest.mark.long
def test_killed_again_and_again_it_ends_in_the_same_bytes(tmp_path):
    """Each kill comes up to 0.1 s after another moment, and the run goes on from there."""
    assert run([*TRAIN, "--out", str(tmp_path / "undisturbed"), "--processes", "1"]) == 0
    expected = content(tmp_path / "undisturbed")
    assert len(expected) == 4 + 2 * 2
    assert {moment for moment in MOMENTS if isinstance(moment, str)} <= set(expected)

    def kill_again_and_again(processes, moments):
        out = tmp_path / processes

        def command():
            going_on = ["--resume"] if (out / "settings.yaml").exists() else []
            return [*TRAIN, "--out", str(out), "--processes", processes, *going_on]

        chance = random.Random(processes)
        for moment in moments:
            process = start(*command())
            wait_for(lambda at=moment, child=process: reached(out, at) or child.poll() is not None, 60.0)
            time.sleep(chance.uniform(0.0, 0.1))
            workers = children(process.pid)
            process.kill()
            wait_for(lambda pids=workers: not any(is_running(pid) for pid in pids), 30)
            process.communicate()
        last = start(*command())
        _, errors = last.communicate(timeout=100)
        assert last.returncode == 0, errors
        return content(out)

    with ThreadPoolExecutor(2) as pool:
        for end in pool.map(kill_again_and_again, ["1", "2"], [MOMENTS, MOMENTS[::2]]):
            assert end == expected


def test_resuming_a_folder_of_strangers_imports_no_module_that_it_names(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "evil_task.py").write_text("from pathlib import Path\nPath('imported').touch()\n")
    (tmp_path / "circuit.yaml").write_text(policy_to_yaml(load_policy("course")))
    settings = {"task": "evil_task:Env-v0", "circuit": "circuit.yaml"}
    record = {"format": 1, "command": "x", "settings": settings, "made_with": {}, "circuit": {}}
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "settings.yaml").write_text(dump_yaml(record))
    assert run(["train", "--out", "run", "--resume"]) == 2
    assert "name it again with --task, as MODULE:ID" in capfd.readouterr().err
    assert not (tmp_path / "imported").exists()
    # The command line names it: then it is imported, and holds no environment.
    assert run(["train", "--out", "run", "--resume", "--task", "evil_task:Env-v0"]) == 2
    assert (tmp_path / "imported").exists()


@pytest.mark.parametrize(
    "mistake", ["--randomize mld", "--randomize mild --worst 99 --rollouts 3", "--course x"]
)
def test_mistake_leaves_no_folder(mistake, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(["train", *mistake.split()]) == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", [[], ["--randomize", "mild", "--rollouts", "2", "--random-courses", "0"]])
def test_moved_folder_of_a_run_is_an_error(kind, tmp_path, capsys, monkeypatch):
    folder, moved = tmp_path / "run", tmp_path / "moved"

    def move(*_, **__):
        if folder.exists():
            folder.rename(moved)

    monkeypatch.setattr(TrainProgress, "show", move)
    monkeypatch.setattr("rich.progress.Progress.update", move)
    command = ["train", "--course", str(COURSE), "--iterations", "60", "--processes", "1", *kind]
    assert run([*command, "--out", str(folder), *([] if kind else ["--agents", "2"])]) == 2
    said = capsys.readouterr().err
    assert f"rover-ncp: {folder}: was moved or removed during the training" in said
    assert (moved / "settings.yaml").is_file()
    assert not folder.exists()
