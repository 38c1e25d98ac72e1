import json
import subprocess
import sys
from importlib.metadata import entry_points, version

import pytest
import typer

from rover_ncp import cli
from rover_ncp.core.errors import NoBridge, SafetyStop, UsageError

MODULES = {point.name: point.module for point in entry_points(group=cli.GROUP)}
HEAVY = ["pymunk", "filterpy", "gymnasium", "matplotlib", "zenoh", "rosbags", "scipy"]


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


FILTER = """
import sys
import deploy.drive.control_loop, deploy.place.docking
before = {"scipy.stats", "scipy.ndimage", "scipy.sparse"} & set(sys.modules)
from filterpy.discrete_bayes import predict
from filterpy.stats import logpdf, norm_cdf
from scipy.stats import multivariate_normal, norm
print(not before, norm_cdf((-1, 2), 0, 4) == norm(0, 2).cdf(2) - norm(0, 2).cdf(-1))
print(logpdf([1.0, 2.0], [0.0, 0.0], [[2, 0], [0, 3]]) == multivariate_normal([0, 0], [2, 3]).logpdf([1, 2]))
print(predict([0.0, 1.0, 0.0], 1, [1.0]).tolist() == [0.0, 0.0, 1.0])
"""


def test_driver_loads_what_it_uses_of_scipy_and_all_of_filterpy_works_still():
    assert python(["-c", FILTER]).stdout.split() == ["True"] * 4


def test_the_version_is_that_of_the_distribution():
    assert python(["-m", "rover_ncp", "--version"]).stdout == f"rover-ncp {version('rover-ncp')}\n"


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
        (ModuleNotFoundError("no", name="matplotlib.figure"), 2),
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
