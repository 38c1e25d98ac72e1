"""The loop of a mock: a simulated base in real time, faults while it runs, and the true pose into a file.

One thread: it sleeps until something arrives or the base's next message is due, then advances the base to the
present.
"""

import logging
import math
import selectors
import time
from collections.abc import Callable
from io import FileIO
from pathlib import Path

from rover_ncp.core.errors import UsageError
from rover_ncp.core.files import create
from rover_ncp.core.geometry import Pose
from sim.base.faults import parse_fault
from sim.base.simulated_base import SimulatedBase
from sim.world.rover import SUBSTEP_S

_LOGGER = logging.getLogger("rover_ncp")
PERIOD_S = SUBSTEP_S
"""The mock sleeps no longer than a step, so a turn that ends later shows how long it had no CPU."""

MAX_READ_BYTES = 65_536

TRUTH_COLUMNS = ("t_ns", "t_s", "x", "y", "theta", "v", "omega", "contact", "clock_ns")
"""Wall clock in ns, time since the start in s, true pose in m and rad, speeds in m/s and rad/s, 0 or 1,
simulation clock in ns: the end of the step on the machine's monotonic clock, whenever it was computed."""


def clock_ns(now: float) -> int:
    """Return a moment of the simulation clock in ns."""
    return round(now * 1e9)


class TruthFile:
    """The true pose as CSV, 100 lines a second, flushed as they come: a kill leaves whole lines behind."""

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        """Raise FileError for a path where a file exists, unless ``overwrite``, or where none can be made."""
        self._file = create(path, overwrite=overwrite)
        self._lines = [",".join(TRUTH_COLUMNS)]
        self.flush()

    def add(self, base: SimulatedBase, t_ns: int, t_s: float) -> None:
        """Note where the rover is at the end of a step."""
        rover = base.drive.rover
        (x, y, theta), (v, omega) = rover.pose, rover.velocity
        self._lines.append(
            f"{t_ns},{t_s:.2f},{x:.6f},{y:.6f},{theta:.6f},{v:.5f},{omega:.5f},{int(rover.in_contact)},"
            f"{clock_ns(base.now)}"
        )

    def flush(self) -> None:
        """Hand over to the system what was noted, in whole lines."""
        if self._lines:
            self._file.write(("\n".join(self._lines) + "\n").encode("ascii"))
            self._file.flush()
            self._lines.clear()

    def close(self) -> None:
        """Write what is left and close."""
        self.flush()
        self._file.close()


class Lateness:
    """The longest delay of a loop's turns since `take`. The turn that is under way counts.

    So a delay before a fault line is reported with the line, and never counts as one after it.
    """

    def __init__(self) -> None:
        self._due_s, self._longest_s = math.inf, 0.0

    def begin(self, allowed_s: float) -> None:
        """Begin a turn that should end within ``allowed_s``."""
        self._due_s = time.monotonic() + allowed_s

    def end(self) -> None:
        """End the turn."""
        self._longest_s = max(self._longest_s, time.monotonic() - self._due_s)

    def take(self) -> float:
        """Return the longest delay so far in s, and start over."""
        self.end()
        longest_s, self._longest_s = self._longest_s, 0.0
        self._due_s = max(self._due_s, time.monotonic())
        return longest_s


class RealTimeLoop:
    """Advances ``base``, whose clock is the machine's monotonic clock; subclasses connect it to a line."""

    def __init__(self, base: SimulatedBase) -> None:
        self.truth: TruthFile | None = None
        """Where the true pose is written from now on."""
        self.show: Callable[[Pose, int], None] = lambda pose, wall_ns: None
        """Receives the true pose of each step with its moment by the wall clock; never waits."""
        self.touched = False
        """Whether the rover ever touched anything."""
        self.heard_s = 0.0
        """When the base last received anything, in s of its clock."""
        # Not epoll, which takes no files: fault lines may come from one, or from /dev/null.
        self.selector = selectors.PollSelector()
        """Calls the data of each key when there is something to read."""
        self._unfinished = b""
        self._lateness = Lateness()
        self.base, self._start_s = base, base.now
        base.observe = self._observe

    def send(self) -> None:
        """Send what the base has to send."""
        raise NotImplementedError

    def serve(self, stopping: Callable[[], bool], fault_lines: FileIO | None = None) -> None:
        """Serve until ``stopping``; each line of ``fault_lines`` is one more fault.

        Each line is answered by ``applied t_ns=… late_ns=… heard_ns=…``: the simulation clock when the fault
        began, how late the loop ended a turn at worst since the line before, and the simulation clock when
        the base last received anything. An empty line asks only for the answer.
        """
        if fault_lines is not None:
            self.selector.register(fault_lines, selectors.EVENT_READ, lambda: self._read_faults(fault_lines))
        while not stopping():
            sleep_s = max(min(self.base.due_s - time.monotonic(), PERIOD_S), 0.0)
            self._lateness.begin(sleep_s)
            for key, _ in self.selector.select(sleep_s):
                key.data()
            self.base.advance(time.monotonic())
            self.send()
            if self.truth:
                self.truth.flush()
            self._lateness.end()

    def close(self) -> None:
        """Close everything."""
        self.selector.close()
        if self.truth:
            self.truth.close()

    def _read_faults(self, fault_lines: FileIO) -> None:
        data = fault_lines.read(MAX_READ_BYTES)  # what is there, without waiting for the end of a line
        *lines, self._unfinished = (self._unfinished + data).split(b"\n")
        if not data:
            self.selector.unregister(fault_lines)
            lines = [self._unfinished] if self._unfinished else []
        for line in lines:
            self._inject(line.decode(errors="replace").strip())

    def _inject(self, text: str) -> None:
        try:
            fault = parse_fault(text) if text else None
        except UsageError as error:
            _LOGGER.info(str(error))
            return
        self.base.advance(time.monotonic())
        if fault is not None:
            self.base.inject(fault)
        began_s, late_s, heard_s = self.base.now, self._lateness.take(), self.heard_s
        answer = f"t_ns={clock_ns(began_s)} late_ns={clock_ns(late_s)} heard_ns={clock_ns(heard_s)}"
        _LOGGER.info(f"applied {answer} {text}".rstrip())

    def _observe(self, now: float) -> None:
        contact = self.base.drive.rover.in_contact
        self.touched |= contact
        wall_ns = time.time_ns() - round((time.monotonic() - now) * 1e9)
        self.show(Pose(*self.base.drive.rover.pose), wall_ns)
        if self.truth:
            self.truth.add(self.base, wall_ns, now - self._start_s)
