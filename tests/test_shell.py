import json
import subprocess
import sys
from importlib.metadata import entry_points

import pytest
import typer

from rover_ncp import shell
from rover_ncp.core.errors import NoBridge, SafetyStop, UsageError

COMMANDS = sorted(point.name for point in entry_points(group=shell.GROUP))
HEAVY = ["numba", "pymunk", "filterpy", "gymnasium", "matplotlib", "plotly", "zenoh", "rosbags", "scipy"]


@pytest.mark.parametrize("command", [[], *[[name] for name in COMMANDS]])
def test_help_teaches_and_imports_nothing_heavy(command):
    code = (
        "import sys; from rover_ncp.shell import run\n"
        f"code = run({[*command, '--help']!r})\n"
        f"heavy = [m for m in {HEAVY!r} if m in sys.modules]\n"
        "sys.stderr.write(repr(heavy)); sys.exit(code)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0
    assert done.stderr == "[]"
    assert "Usage: rover-ncp" in done.stdout
    if command:
        assert "--json" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["fly"], "No such command 'fly'"),
        (["train", "--agens", "3"], "--agens"),
        (["train", "--agents", "x"], "'--agents'"),
    ],
)
def test_a_wrong_command_line_is_one_line_and_exit_code_2(arguments, expected, capsys):
    assert shell.run(arguments) == 2
    err = capsys.readouterr().err
    assert expected in err
    assert err.count("\n") == 1


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
def test_errors_become_one_line_an_exit_code_and_one_json_object(raised, code, capsys, monkeypatch):
    def fail(json: bool = False) -> None:
        raise raised

    app = typer.Typer()
    app.callback()(lambda: None)
    app.command("fail")(fail)
    monkeypatch.setattr(shell, "_app", lambda: app)
    assert shell.run(["fail", "--json"]) == code
    out, err = capsys.readouterr()
    assert err.count("\n") == 1
    assert "Traceback" not in err
    assert "\x1b" not in err
    fields = json.loads(out)
    assert fields["exit_code"] == code
    assert fields["error"] in err


def test_a_missing_extra_names_what_to_install(capsys, monkeypatch):
    app = typer.Typer()
    app.callback()(lambda: None)

    @app.command("fail")
    def fail() -> None:
        raise ModuleNotFoundError("No module named 'numba'", name="numba")

    monkeypatch.setattr(shell, "_app", lambda: app)
    assert shell.run(["fail"]) == 2
    assert "pip install 'rover-ncp[drive]'" in capsys.readouterr().err


def test_a_bug_is_a_traceback_not_a_user_error(monkeypatch):
    app = typer.Typer()
    app.callback()(lambda: None)

    @app.command("fail")
    def fail() -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(shell, "_app", lambda: app)
    with pytest.raises(ZeroDivisionError):
        shell.run(["fail"])


def test_a_commands_return_value_is_the_exit_code(monkeypatch):
    app = typer.Typer()
    app.callback()(lambda: None)

    @app.command("one")
    def one() -> int:
        return 1

    @app.command("none")
    def none() -> None:
        return None

    monkeypatch.setattr(shell, "_app", lambda: app)
    assert shell.run(["one"]) == 1
    assert shell.run(["none"]) == 0
