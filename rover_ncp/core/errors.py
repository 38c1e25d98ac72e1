"""The error tree: every error that a public function raises on purpose.

    RoverNcpError
    ├── UsageError          exit code 2: ConfigError, FileError, PortInUse, MissingExtra
    ├── UnreachableError    exit code 3: NoRobot, NoBridge, NotAuthorised, AnotherDriver,
    │                       NoPose
    ├── FormatError
    └── SafetyStop          exit code 4

A message is one line that names what was found, where, and what was expected. Errors of libraries are
wrapped with ``raise ... from``. Anything else that reaches the user is a bug and shows its traceback.
"""

import shlex
from collections.abc import Sequence

INTERRUPTED = 130
"""Exit code of a command that was interrupted."""


class RoverNcpError(Exception):
    """Root of the tree; ``exit_code`` is what the command line returns."""

    exit_code = 2


class UsageError(RoverNcpError):
    """A bad option, file or value of the caller."""


MAX_PROBLEMS = 20
"""Problems of a file that its message shows."""


class ConfigError(UsageError):
    """A configuration is wrong. ``problems`` holds one line each, with the path of the value."""

    def __init__(self, source: str, problems: Sequence[str]) -> None:
        self.source = source
        self.problems = tuple(problems)
        more = len(self.problems) - MAX_PROBLEMS
        shown = [*self.problems[:MAX_PROBLEMS], *([f"and {more} more"] if more > 0 else [])]
        super().__init__(f"{source}: " + "; ".join(shown))


class FileError(UsageError):
    """A file is missing, unreadable, damaged or of another format."""


class PortInUse(UsageError):
    """Another process already listens on the address."""


class MissingExtra(UsageError):
    """A command needs a library of an extra that is not installed."""

    def __init__(self, library: str, requirement: str, arguments: Sequence[str]) -> None:
        super().__init__(
            f"{arguments[0]} needs {library}, which is not installed. Install it with: "
            f"pip install '{requirement}'. Or run without an installation: "
            f"uvx --from '{requirement}' rover-ncp {shlex.join(arguments)}"
        )


class UnreachableError(RoverNcpError):
    """The peer cannot be used."""

    exit_code = 3


class NoRobot(UnreachableError):
    """The base does not answer, or not as a base."""


class NoBridge(UnreachableError):
    """No bridge answers on Zenoh."""


class NotAuthorised(UnreachableError):
    """The bridge answers but rejects this driver."""


class AnotherDriver(UnreachableError):
    """Another driver holds the lease."""


class NoPose(UnreachableError):
    """No external pose of the rover arrives, although one is required."""


class FormatError(RoverNcpError):
    """Bytes or text from a peer do not fit their key: they are counted and dropped."""


class SafetyStop(RoverNcpError):
    """A safety rule stopped the rover; ``rule`` is its short name.

    ``by`` names the person or program that stopped it, which the message has in place of the rule.
    """

    exit_code = 4

    def __init__(self, rule: str, detail: str = "", *, by: str = "") -> None:
        self.rule = rule
        self.detail = detail
        super().__init__(f"stopped by {by or rule}" + (f": {detail}" if detail else ""))
