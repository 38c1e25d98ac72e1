"""The ``rover-ncp`` command: finds its subcommands through entry points and turns errors into exit codes.

A package contributes a command by an entry point in the group ``rover_ncp.commands`` whose object is a
plain function with typer annotations, in a module that imports nothing heavy at its top. The function
returns its exit code, or None for 0. Only the module of the command that runs is imported; ``--help`` imports
all of them for their first lines.
"""

import inspect
import json
import os
import sys
from importlib.machinery import PathFinder
from importlib.metadata import distribution, entry_points
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from rover_ncp.core.console import Output, print_line, printable, unwritten
from rover_ncp.core.errors import INTERRUPTED, FileError, MissingExtra, RoverNcpError
from rover_ncp.core.process import end_with_parent, interrupt_on_signals

GROUP = "rover_ncp.commands"
_OWN_PACKAGES = ("bridge", "deploy", "sim")
EXIT_CODES = {
    0: "done",
    1: "not parked or docked; a check that failed; a recording that replays differently; no pose to send",
    2: "wrong option, configuration or file; port in use; missing extra; output that could not be written",
    3: "no robot, bridge or pose; not authorised; another driver; driver and bridge of different versions",
    4: "stopped by a safety rule, which is named",
    130: "interrupted by Ctrl-C, SIGTERM or SIGHUP, after the rover was stopped",
}
"""The meaning of each exit code."""

# Which extra brings a library that a command found missing.
_LIBRARIES = {
    **dict.fromkeys(("filterpy", "scipy", "matplotlib", "cryptography"), "drive"),
    **dict.fromkeys(("jinja2", "markupsafe", "anyio", "starlette", "uvicorn", "websockets"), "drive"),
    **dict.fromkeys(("pymunk", "cmaes", "gymnasium"), "train"),
    **dict.fromkeys(("apriltag", "cv2"), "tag"),
    **dict.fromkeys(("mujoco", "imageio", "distributed", "psutil"), "research"),
}
# Which extra a command needs for whatever it does, and which one an option adds.
_COMMANDS = {
    **dict.fromkeys(("park", "train", "eval", "mock", "explain"), "train"),
    **dict.fromkeys(("deploy", "replay", "identify", "place", "course", "export"), "drive"),
    **dict.fromkeys(("watch", "report", "keys"), "drive"),
    "tag": "tag",
}
_OPTIONS = {
    **dict.fromkeys(("--dock", "--images", "--camera"), "tag"),
    **dict.fromkeys(("mujoco", "--cluster"), "research"),
}
_BROUGHT = {"train": {"drive"}, "tag": {"drive"}, "research": {"drive", "train"}}
"""Extras that another one makes superfluous for the libraries of its commands."""
# The panels of ``--help``, in the order in which a newcomer meets the commands. Other packages' come first.
_PANELS = {
    "Park": ["park"],
    "Train": ["train", "eval", "explain", "export"],
    "Drive": ["up", "deploy", "stop", "teleop", "course", "place", "tag"],
    "Look": ["watch", "report", "replay", "recover"],
    "Robot": ["setup", "mock", "bridge", "check", "identify", "keys"],
}
_PANEL = {name: panel for panel, names in _PANELS.items() for name in names}
# The base class of errors for a wrong command line. Typer publishes only its subclasses.
_WrongCommandLine: type[Exception] = typer.BadParameter.__mro__[2]


class _Commands(TyperGroup):
    """The installed commands, each imported when it is used."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self._points = {point.name: point for point in entry_points(group=GROUP)}
        # Typer suggests these names for a mistyped one; it reads nothing else of them.
        self.commands = dict.fromkeys(self._points)  # type: ignore[assignment]

    def list_commands(self, ctx: Any) -> list[str]:
        return [*sorted(set(self._points) - set(_PANEL)), *(name for name in _PANEL if name in self._points)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in self._points:
            return None
        found = self._points[cmd_name].load()
        if isinstance(found, typer.Typer):  # a command of several
            command: Any = get_command(found)
        else:
            app = typer.Typer(add_completion=False)
            app.command(cmd_name)(found)
            command = get_command(app)
        command.rich_help_panel = _PANEL.get(cmd_name)
        for each in (command, *getattr(command, "commands", {}).values()):
            each.help = _unwrapped(each.help)
        return command


def _unwrapped(text: str | None) -> str:
    """Return a help with each paragraph in one line: a terminal breaks lines at its own width."""
    paragraphs = inspect.cleandoc(text or "").split("\n\n")
    return "\n\n".join(each if each.startswith(" ") else each.replace("\n", " ") for each in paragraphs)


def _print_version(requested: bool) -> None:
    if requested:
        print_line(sys.stdout, f"rover-ncp {distribution('rover-ncp').version}")
        raise typer.Exit


def _app() -> typer.Typer:
    app = typer.Typer(
        cls=_Commands,
        name="rover-ncp",
        help="Train a tiny worm circuit to park a rover in simulation, then drive a robot with it.",
        epilog="Exit codes: " + ". ".join(f"{code} {text}" for code, text in EXIT_CODES.items()) + ".",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
    )
    app.callback()(_options)
    return app


def _options(
    version: Annotated[  # its callback ends the command
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Take the options that go before a command."""


def _fail(message: str, kind: str, code: int, as_json: bool) -> int:
    Output.ended = True
    unwritten()
    line = printable(" ".join(message.split()))
    print_line(sys.stderr, f"rover-ncp: {line}")
    if as_json:
        fields: dict[str, Any] = {"error": line, "kind": kind, "exit_code": code}
        print_line(sys.stdout, json.dumps(fields))
    return code


def _missing(library: str, arguments: list[str]) -> MissingExtra:
    """Return the error for a library that a command line did not find."""
    words = {word for argument in arguments for word in argument.split("=")}
    extras = {_LIBRARIES[library], _COMMANDS.get(arguments[0], _LIBRARIES[library])}
    extras |= {extra for option, extra in _OPTIONS.items() if option in words}
    extras = extras.difference(*(_BROUGHT.get(extra, set()) for extra in extras))
    requirement = f"rover-ncp[{','.join(sorted(extras))}]"
    # The file, folder or repository that it was installed from: an index may not have this version.
    if origin := json.loads(distribution("rover-ncp").read_text("direct_url.json") or "{}"):
        requirement += f" @ {'git+' if 'vcs_info' in origin else ''}{origin['url']}"
    return MissingExtra(library, requirement, arguments)


def _failed(error: Exception, arguments: list[str]) -> int:
    """Report a user's mistake and return its exit code; raise any other error, which is a bug."""
    as_json = "--json" in arguments
    if isinstance(error, _WrongCommandLine):
        message = error.format_message() if hasattr(error, "format_message") else str(error)
        # Without a message typer has just shown the help: a command was missing.
        return _fail(message, "UsageError", 2, as_json) if message else 2
    if isinstance(error, ModuleNotFoundError):
        library = (error.name or "").split(".")[0]
        if library in _LIBRARIES:
            error = _missing(library, arguments)
    if isinstance(error, OSError):  # such as the use of a deleted folder
        place = f"{error.filename}: " if error.filename else ""
        error = FileError(f"{place}{error.strerror or error}")
    if isinstance(error, RoverNcpError):
        return _fail(str(error), type(error).__name__, error.exit_code, as_json)
    raise error


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit code; one of `EXIT_CODES`."""
    Output.ended, Output.lines = False, None
    try:
        code = _run(arguments)
        if (reason := unwritten()) and code in {0, 1}:
            code = _fail(f"standard output cannot be written: {reason}", "FileError", 2, as_json=False)
    except KeyboardInterrupt:
        code = interrupted(arguments)
    finally:
        Output.blocked = bool(unwritten())
        Output.lines = None
    return code


def _run(arguments: list[str]) -> int:
    try:
        result = _app()(args=arguments, prog_name="rover-ncp", standalone_mode=False)
    except KeyboardInterrupt:
        return interrupted(arguments)
    except Exception as error:
        eof = error.__cause__ if isinstance(error, typer.Abort) else None
        if isinstance(eof, EOFError):  # typer takes each one for the end of a dialog
            raise eof from None
        if isinstance(error, typer.Abort):
            return interrupted(arguments)
        return _failed(error, arguments)
    if result == INTERRUPTED:  # typer turns Ctrl-C into this code, without a message
        return interrupted(arguments)
    return result if isinstance(result, int) else 0


def interrupted(arguments: list[str]) -> int:
    """Report an interruption, unless the command has printed its own result; return the exit code."""
    if not Output.ended:
        _fail("interrupted", "Interrupted", INTERRUPTED, "--json" in arguments)
    return INTERRUPTED


def _prefer_own_packages() -> list[str]:
    """Let no module of a user, on PYTHONPATH or in the working folder, take the place of a package of ours.

    Its folder goes behind ours in ``sys.path``, which processes that this one spawns take over. Returns the
    modules that would have been imported.
    """
    ours = str(Path(__file__).parents[1])
    if ours not in sys.path:
        sys.path.append(ours)
    shadows = {}
    for folder in sys.path[: sys.path.index(ours)]:
        if os.path.realpath(folder) == os.path.realpath(ours):  # such as "" where that is the current folder
            continue
        found = [PathFinder.find_spec(name, [folder or os.curdir]) for name in _OWN_PACKAGES]
        if modules := [each.origin or each.name for each in found if each is not None and each.loader]:
            shadows[folder] = modules
    for folder in shadows:
        sys.path.remove(folder)
        sys.path.insert(sys.path.index(ours) + 1, folder)
    return [module for modules in shadows.values() for module in modules]


def main() -> int:
    """Run the command line of this process, and return its exit code."""
    # Python would put the current folder in front of all packages in each child, and a user's folder may hold
    # a sim/ or a scipy.py of its own.
    os.environ["PYTHONSAFEPATH"] = "1"
    # Read by numpy and scipy when they are loaded. For matrices as small as ours BLAS's threads only wait for
    # each other: on a busy machine planning a course took fifty times as long with two.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Pictures go into files. Jupyter's backend is no name that every installation of matplotlib knows.
    os.environ["MPLBACKEND"] = "agg"
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed before the process started
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115, PTH123  # open to the end
        getattr(sys, name).reconfigure(errors="backslashreplace")
    interrupt_on_signals()
    end_with_parent()
    for module in _prefer_own_packages():
        print_line(sys.stderr, f"rover-ncp: {module} is not used: a package of rover-ncp has its name")
    code = run(sys.argv[1:])
    if Output.blocked:  # at its end Python would wait for the thread that writes
        os._exit(code)
    return code
