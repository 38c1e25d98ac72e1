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

COMMANDS = sorted(point.name for point in entry_points(group=cli.GROUP))
NO_BRIDGE = "--robot tcp/127.0.0.1:1"
HEAVY = ["numba", "pymunk", "filterpy", "gymnasium", "matplotlib", "plotly", "zenoh", "rosbags", "scipy"]


# Prints, for each command line, the exit code, the help, and the modules that are loaded by then.
HELP = """
import contextlib, io, json, sys
from rover_ncp.cli import run
for command in json.loads(sys.argv[1]):
    with contextlib.redirect_stdout(io.StringIO()) as out:
        code = run([*command, "--help"])
    print(json.dumps([code, out.getvalue(), sorted(sys.modules)]))
"""


def python(arguments, **how):
    """Run Python in a process of its own."""
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, timeout=100, check=True, **how
    )


def help_of(commands):
    """Ask for help on command lines, in one process; return (exit code, help, loaded modules) of each."""
    done = python(["-c", HELP, json.dumps(commands)])
    assert done.stderr == ""
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_help_teaches_and_imports_nothing_heavy():
    answers = help_of([[], *[[name] for name in COMMANDS]])
    assert len(answers) == 1 + len(COMMANDS)
    for name, (code, text, loaded) in zip(["", *COMMANDS], answers, strict=True):
        assert (code, [module for module in HEAVY if module in loaded]) == (0, []), name
        assert "Usage: rover-ncp" in text
        assert "--json" in text or not name


@pytest.mark.parametrize("name", ["park", "train", "bench", "deploy", "report", "recover"])
def test_a_command_imports_no_other_commands_module(name):
    modules = {point.name: point.module for point in entry_points(group=cli.GROUP)}
    [(_, _, loaded)] = help_of([[name]])
    assert modules[name] in loaded
    assert set(modules.values()) & set(loaded) == {modules[name]}


def rover_ncp(*arguments, **environment):
    """Run the command as a user does; return its output."""
    return python(["-m", "rover_ncp", *arguments], env={**os.environ, **environment}).stdout


def test_the_version_is_that_of_the_distribution():
    assert rover_ncp("--version") == f"rover-ncp {version('rover-ncp')}\n"


def test_shells_complete_commands_and_options():
    asked = {"_ROVER_NCP_COMPLETE": "complete_bash", "COMP_WORDS": "rover-ncp tr", "COMP_CWORD": "1"}
    assert rover_ncp(**asked).split() == ["train"]
    asked |= {"COMP_WORDS": "rover-ncp train --ag", "COMP_CWORD": "2"}
    assert rover_ncp(**asked).split() == ["--agents"]


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
        (NoBridge("none"), 3),
        (SafetyStop("bumper", "front"), 4),
        (KeyboardInterrupt(), 130),
        (typer.Abort(), 130),
        (ModuleNotFoundError("no", name="plotly.graph_objects"), 2),
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


def test_a_bug_is_a_traceback_not_a_user_error(run_command):
    def fail():
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run_command(fail)


@pytest.mark.parametrize(("returned", "code"), [(1, 1), (None, 0)])
def test_a_commands_return_value_is_the_exit_code(returned, code, run_command):
    def give():
        return returned

    assert run_command(give) == code


NEEDS = {
    "": [
        "urdf",
        "recover no.mcap",
        "bridge --base tcp/127.0.0.1:1 --limits no.yaml",
        f"check --on-blocks {NO_BRIDGE}",
        f"teleop {NO_BRIDGE}",
    ],
    "drive": [
        f"deploy {NO_BRIDGE}",
        "replay no.mcap",
        "identify no.mcap",
        "course check parking",
        "export no.yaml --to c --out exported",
        "export parking --to c --out exported",
    ],
    "drive,report": [f"watch {NO_BRIDGE} --port 0", "report no.mcap"],
    "keys": ["keys --out keys"],
    "train": [
        "train --course no.yaml",
        "eval parking",
        "mock --listen nowhere",
        "explain no.mcap",
        "paper report",
    ],
    "report,train": ["park --course no.yaml"],
}
"""Command lines that end at once, by the extras they need."""
WITHOUT = """
import json, os, sys
from importlib.abc import MetaPathFinder
from rover_ncp import cli

missing, lines = json.loads(sys.argv[1])

class Missing(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.split(".")[0] in missing:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
for line in lines:
    print("$", line, file=sys.stderr)
    cli.run(line.split())
"""


def without(missing, lines, folder):
    """Run command lines, one after the other, where these libraries cannot be found; return what they say."""
    asked = json.dumps([sorted(missing), lines])
    done = python(["-c", WITHOUT, asked], cwd=folder, stdin=subprocess.DEVNULL)
    return [part.split("\n", 1) for part in done.stderr.split("$ ")[1:]]


def test_a_missing_library_names_an_extra_of_the_command_in_one_line(tmp_path):
    lines = [line for extras, lines in NEEDS.items() if extras for line in lines]
    told = without(cli._EXTRAS, lines, tmp_path)
    assert [line for line, _ in told] == lines
    for extras, own in NEEDS.items():
        expected = "|".join([*extras.split(","), *["drive"] * ("train" in extras)])
        for line, words in told:
            if line in own:
                pattern = rf"rover-ncp: \w+ is not installed: .* the extra ({expected}), as .*\n"
                assert re.fullmatch(pattern, words), line


@pytest.mark.parametrize("extras", NEEDS)
def test_the_extras_that_are_named_are_enough(extras, tmp_path):
    brought = set(extras.split(",")) | ({"drive"} if "train" in extras else set())
    missing = {library for library, extra in cli._EXTRAS.items() if extra not in brought}
    if "report" in brought:
        missing -= {"matplotlib"}  # of both
    for line, words in without(missing, NEEDS[extras], tmp_path):
        assert "is not installed" not in words, line
