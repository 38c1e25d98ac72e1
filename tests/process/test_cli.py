import json
import os
import re
import subprocess
import sys
from importlib.metadata import entry_points, version

import pytest
import typer

from rover_ncp import cli
from rover_ncp.core.errors import NoBridge, SafetyStop, UsageError

MODULES = {point.name: point.module for point in entry_points(group=cli.GROUP)}
NO_BRIDGE = "--robot tcp/127.0.0.1:1"
HEAVY = ["pymunk", "filterpy", "gymnasium", "matplotlib", "plotly", "zenoh", "rosbags", "scipy"]


# Prints, for each command, the exit code of its help, the help, and the modules that are loaded by then.
HELP = """
import contextlib, io, json, os, sys
import typer._adapters, typer.rich_utils
from rover_ncp.cli import run
for command in json.loads(sys.argv[1]):
    if not (child := os.fork()):
        with contextlib.redirect_stdout(io.StringIO()) as out:
            code = run([*command.split(), "--help"])
        print(json.dumps([code, out.getvalue(), sorted(sys.modules)]), flush=True)
        os._exit(0)
    os.waitpid(child, 0)
"""


PARTS = {"tag": "tag run"}
"""Of a command of several, one."""


def python(arguments, **how):
    """Run Python in a process of its own."""
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=True, **how)


def test_help_teaches_and_a_command_imports_nothing_heavy_and_no_other_command():
    commands = ["", *(PARTS.get(name, name) for name in MODULES)]
    done = python(["-c", HELP, json.dumps(commands)])
    assert done.stderr == ""
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    for name, (code, text, loaded) in zip(["", *MODULES], answers, strict=True):
        assert (code, [module for module in HEAVY if module in loaded]) == (0, []), name
        assert "Usage: rover-ncp" in text
        if name:
            assert "--json" in text
            assert set(MODULES.values()) & set(loaded) == {MODULES[name]}


def test_the_version_is_that_of_the_distribution():
    assert python(["-m", "rover_ncp", "--version"]).stdout == f"rover-ncp {version('rover-ncp')}\n"


def test_neither_a_users_modules_nor_jupyters_backend_keep_a_command_from_running(tmp_path):
    (tmp_path / "deploy.py").write_text("raise ValueError")
    command = ["-m", "rover_ncp", "course", "check", "parking", "--out", "picture.png"]
    environment = os.environ | {"PYTHONPATH": ".", "MPLBACKEND": "module://no_such.backend"}
    done = python(command, cwd=tmp_path, env=environment)
    assert f"{tmp_path / 'deploy.py'} is not used" in done.stderr


@pytest.fixture
def run_command(monkeypatch):
    """Run a command line where a function is the only command, called ``it``."""

    def run(function, *arguments):
        app = typer.Typer()
        app.callback()(lambda: None)
        app.command("it")(function)
        monkeypatch.setattr(cli, "_app", lambda: app)
        return cli.run(["it", *arguments])

    return run


@pytest.mark.parametrize(
    ("raised", "code"),
    [
        (UsageError("bad\nthing"), 2),
        (NoBridge("held by \x1b[2J"), 3),
        (SafetyStop("bumper", "front"), 4),
        (KeyboardInterrupt(), 130),
        (typer.Abort(), 130),
    ],
)
def test_errors_become_one_line_an_exit_code_and_one_json_object(raised, code, capsys, run_command):
    def fail(json=False):
        raise raised

    assert run_command(fail, "--json") == code
    out, err = capsys.readouterr()
    assert err.count("\n") == 1
    assert "Traceback" not in err
    assert "\x1b" not in err
    fields = json.loads(out)
    assert fields["exit_code"] == code
    assert fields["error"] in err


@pytest.mark.parametrize("bug", [ZeroDivisionError, EOFError])  # a damaged file's end is no interruption
def test_a_bug_is_a_traceback_not_a_user_error(bug, run_command):
    def fail():
        raise bug

    with pytest.raises(bug):
        run_command(fail)


NEEDS = {
    "": ["bridge --base tcp/127.0.0.1:1 --limits no.yaml", f"check --on-blocks {NO_BRIDGE}"],
    "drive": [
        f"deploy {NO_BRIDGE} --policy parking",
        "export parking --to c --out exported",
        f"watch {NO_BRIDGE} --port 0 --policy parking",
        "keys --out keys",
    ],
    "train": ["train --course no.yaml", "eval parking", "mock --listen nowhere"],
}
"""Command lines that end at once, by the extra they need."""
BROUGHT = {"": {""}, "drive": {"drive"}, "train": {"drive", "train"}}
"""By the extra that a user installs, all that it brings."""
WITHOUT = """
import json, os, sys
from importlib.abc import MetaPathFinder
import typer._adapters, typer.rich_utils
from rover_ncp import cli
from rover_ncp.wire import zenoh

class Missing(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.split(".")[0] in missing:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

zenoh.CLIENT["connect/timeout_ms"] = 100
for missing, lines in json.loads(sys.argv[1]):
    if "filterpy" not in missing:
        import filterpy.kalman, scipy.optimize, scipy.stats  # the extra "drive", once for all forks
    if not (child := os.fork()):
        sys.meta_path.insert(0, Missing())
        for line in lines:
            print("$", line, file=sys.stderr)
            cli.run(line.split())
        sys.stderr.flush()
        os._exit(0)
    os.waitpid(child, 0)
    print("#", file=sys.stderr, flush=True)
"""


def test_a_missing_library_names_an_extra_of_the_command_in_one_line_and_that_is_enough(tmp_path):
    tasks = [(list(cli._EXTRAS), [line for extra, lines in NEEDS.items() if extra for line in lines])]
    for extra, lines in NEEDS.items():
        missing = [library for library, its in cli._EXTRAS.items() if its not in BROUGHT[extra]]
        tasks.append((missing, lines))
    done = python(["-c", WITHOUT, json.dumps(tasks)], cwd=tmp_path, stdin=subprocess.DEVNULL)
    answers = done.stderr.split("#\n")[:-1]
    without, *found = [dict(part.split("\n", 1) for part in answer.split("$ ")[1:]) for answer in answers]
    assert [list(each) for each in (without, *found)] == [lines for _, lines in tasks]
    for extra, answers in zip(NEEDS, found, strict=True):
        expected = "|".join(BROUGHT[extra])
        for line, words in answers.items():
            pattern = rf"rover-ncp: \w+ is not installed: .* the extra ({expected}), as .*\n"
            assert not extra or re.fullmatch(pattern, without[line]), line
            assert "is not installed" not in words, line
