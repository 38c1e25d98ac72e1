"""The command ``up``: bridge, localiser and page of one robot, in one terminal.

Rules of this file:

1. The bridge is first at both ends: the others start when it serves drivers, and a signal reaches it before
   them, so that the rover is stopped first.
2. The bridge is never restarted: its end ends all. The others are restarted.
3. No child outlives this process: each one holds a pipe that ends with it.
"""

import math
import signal
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from pydantic import Field

from deploy.up.advice import Begin, LineBreaks
from deploy.up.lock import RobotLock
from deploy.up.restarts import Restarts
from rover_ncp.core.bridge_lines import LEASE_OF, READY
from rover_ncp.core.child import Child, ParentPipe
from rover_ncp.core.config import ResultModel, read_yaml
from rover_ncp.core.console import Output
from rover_ncp.core.errors import FileError, UsageError
from rover_ncp.core.files import read_text
from rover_ncp.core.process import Interrupts
from rover_ncp.robot.robot_file import RobotFile

POLL_S = 0.05
BRIDGE_END_S, OTHER_END_S = 5.0, 3.0
"""Time limits of the ends of the bridge, and of each other process."""
LINES, LINES_PER_S = 10.0, 1.0
"""Lines of one process that are shown at once, and how fast as many may follow."""
PROVEN_S = 5.0
"""A process that was started again works if it runs for so long after its first line: a camera that is not
there ends it before."""
KILLED = 3
"""Exit code when the bridge was killed."""
WATCHDOG = "only the base's own watchdog stops the rover now"


class UpResult(ResultModel):
    """Result of the command ``up``."""

    robot: str = Field(description="the robot's file")
    bridge: str = Field(description="how the bridge ended")
    restarts: dict[str, int] = Field(description="of the other processes, by name")
    resumed: int = Field(description="dockings that resumed after a lost line")
    exit_code: int = Field(description="of the bridge, and of this command")


class _Part:
    """One process with its line of state: the bridge, the localiser, the page or a docking."""

    def __init__(self, name: str, arguments: Sequence[str], log: Path, output: Output) -> None:
        self.name, self._arguments, self.log, self._output = name, arguments, log, output
        self.child: Child | None = None
        self.restarts = Restarts()
        self._shown, self._complaint = "", ""
        """The last state that was shown, and how the process ended that was started again."""
        self._pending: list[str] = []
        self._first_line_s = math.inf
        self._allowed, self._filled_s, self._left_out = LINES, time.monotonic(), 0

    def start(self, pipe: ParentPipe) -> None:
        """Start the process."""
        self.child, self._first_line_s = Child(self._arguments, self.log, pipe), math.inf

    def say(self, state: str) -> None:
        """Show a state, if it is another than the last one."""
        now_s = time.monotonic()
        self._allowed = min(self._allowed + LINES_PER_S * (now_s - self._filled_s), LINES)
        self._filled_s = now_s
        if state == self._shown:
            return
        if self._allowed < 1.0:
            self._left_out += 1
            return
        more = f" ({self._left_out} lines before are in {self.log} only)" if self._left_out else ""
        self._allowed, self._left_out, self._shown = self._allowed - 1.0, 0, state
        self._output.announce(f"{self.name:<9} {state}{more}")

    def watch(self, pipe: ParentPipe) -> None:
        """Show its new lines, and start it again when it has ended and a restart is due."""
        now_s = time.monotonic()
        if self.child is None:
            if self.restarts.due(now_s):
                self.restarts.started()
                self.start(pipe)
            return
        ended = self.child.code is not None  # looked up first: its last lines count
        lines = self.child.new_lines()
        if lines:
            self._first_line_s = min(self._first_line_s, now_s)
        if ended:
            self._restart_later(self.child, now_s)
        elif self._complaint:
            self._pending = [*self._pending, *lines][-1:]
            if now_s - self._first_line_s >= PROVEN_S:
                self._complaint = ""
                for line in self._pending:
                    self.say(f"{line} (restart {self.restarts.count})")
        else:
            for line in lines:
                self.say(line)

    def _restart_later(self, child: Child, now_s: float) -> None:
        wait_s = self.restarts.ended(now_s, child.began_s)
        if child.end != self._complaint:
            self.say(f"{child.end}; starts again in {wait_s:g} s, then less and less often")
        self._complaint, self._pending, self.child = child.end, [], None
        child.close()


def run(file: RobotFile, logs: Path, output: Output, *, localise: bool, page: bool) -> int:
    """See ``commands.up``; return the exit code."""
    base = file.need("base", "'up' starts the bridge to it")
    with Interrupts() as interrupts, RobotLock(base), ParentPipe() as pipe:
        _renew(logs, ("bridge", "localiser", "page", "docking"))
        up = _Up(file, logs, output, interrupts, pipe)
        output.announce(f"{'up':<9} {file.path}; logs in {logs}")
        up.run(localise=localise, page=page)
        result = up.result()
    output.result(result, f"{'bridge':<9} {result.bridge}")
    return result.exit_code


def _renew(logs: Path, names: Sequence[str]) -> None:
    """Begin new logs, and keep those of the run before as NAME.log.old. Raises FileError."""
    try:
        logs.mkdir(parents=True, exist_ok=True)
        for name in names:
            with suppress(FileNotFoundError):
                (logs / f"{name}.log").rename(logs / f"{name}.log.old")
    except OSError as error:
        raise FileError(f"{logs}: cannot be written: {error.strerror}") from error


class _Up:
    """One run."""

    def __init__(
        self, file: RobotFile, logs: Path, output: Output, interrupts: Interrupts, pipe: ParentPipe
    ) -> None:
        self._file, self._logs, self._output = file, logs, output
        self._interrupts, self._pipe = interrupts, pipe
        self._bridge = self._part("bridge", "bridge", "--robot", str(file.path))
        self._others: list[_Part] = []
        self._docking: _Part | None = None
        self._resumed = 0
        self._breaks = LineBreaks(fenced=_has_fence(file), resume=file.settings.resume)
        self._late = False

    def run(self, *, localise: bool, page: bool) -> None:
        """Serve until a signal or the end of the bridge, then end all."""
        robot = str(self._file.path)
        waiting = [self._part("localiser", "tag", "run", "--robot", robot)] if localise else []
        waiting += [self._part("page", "watch", "--robot", robot)] if page else []
        self._bridge.start(self._pipe)
        try:
            while not self._interrupts.raised:
                if self._watch_bridge():
                    for part in waiting:
                        part.start(self._pipe)
                        self._others.append(part)
                    waiting = []
                if self._child.code is not None:
                    break
                for part in self._others:
                    part.watch(self._pipe)
                self._watch_docking()
                time.sleep(POLL_S)
        finally:
            self._end()

    def result(self) -> UpResult:
        """Return how it ended."""
        code = self._child.code
        assert code is not None  # all processes have ended
        return UpResult(
            robot=str(self._file.path),
            bridge=self._how(),
            restarts={part.name: part.restarts.count for part in self._others},
            resumed=self._resumed,
            exit_code=code if code >= 0 else KILLED,
        )

    @property
    def _child(self) -> Child:
        assert self._bridge.child is not None  # it is never restarted
        return self._bridge.child

    def _part(self, name: str, *arguments: str) -> _Part:
        return _Part(name, arguments, self._logs / f"{name}.log", self._output)

    def _watch_bridge(self) -> bool:
        """Show the bridge's new lines, and return whether it became ready."""
        ready = False
        for line in self._child.new_lines():
            advice = self._breaks.take(line, time.monotonic())
            if not line.startswith(LEASE_OF):
                self._bridge.say(f"{line}; {advice}" if advice else line)
            ready |= line.startswith(READY)
        return ready

    def _watch_docking(self) -> None:
        if self._docking is not None:
            assert self._docking.child is not None  # it is started once
            lines, ended = self._docking.child.new_lines(), self._docking.child.code is not None
            for line in lines[:1] if ended else lines:  # the verdict is the first line of a result
                self._docking.say(line)
            if self._breaks.recall():
                self._docking.say(
                    "ends: a hazard, a stop, another driver or a restart of odometry came before it drove"
                )
                self._docking.child.send(signal.SIGTERM)
            if ended:
                self._docking.say(self._docking.child.end if self._docking.child.code else "ended with 0")
                self._docking.child.close()
                self._docking = None
                self._breaks.ended()
        elif (begin := self._breaks.due(time.monotonic())) is not None:
            self._dock(begin)

    def _dock(self, begin: Begin) -> None:
        self._resumed += 1
        self._docking = self._part("docking", "deploy", "--robot", str(self._file.path), "--to", begin.place)
        self._docking.say(f"at {begin.place} resumes ({begin.number})")
        self._docking.start(self._pipe)

    def _end(self) -> None:
        """End the bridge, which stops the rover, and then the others."""
        number = self._interrupts.received[0] if self._interrupts.received else signal.SIGTERM
        if self._child.code is None:
            self._bridge.say("stops the rover and ends")
            self._child.send(number)
        self._late = not self._child.wait(BRIDGE_END_S)
        self._child.new_lines()  # its last one is a part of how it ended
        parts = [*self._others, *([self._docking] if self._docking else [])]
        children = [part.child for part in parts if part.child is not None]
        for child in children:
            child.send(signal.SIGTERM)
        deadline_s = time.monotonic() + OTHER_END_S
        for child in children:
            child.wait(max(deadline_s - time.monotonic(), 0.0))
            child.close()

    def _how(self) -> str:
        """Return how the bridge ended, in words."""
        if self._late:
            return f"did not end within {BRIDGE_END_S:g} s and was killed: {WATCHDOG}"
        killed = (self._child.code or 0) < 0
        return f"{self._child.end}: {WATCHDOG}" if killed else self._child.end


def _has_fence(file: RobotFile) -> bool:
    limits = file.settings.limits
    if isinstance(limits, dict):
        return "fence" in limits
    with suppress(UsageError):  # the bridge says what is wrong
        found = read_yaml(read_text(file.limits), str(file.limits)) if file.limits else None
        return isinstance(found, dict) and "fence" in found
    return False
