"""The time a rover took to stop, from the true motion that its mock wrote."""

import csv
import time
from bisect import bisect_left
from pathlib import Path
from typing import NamedTuple, TextIO

from rover_ncp.core.errors import RoverNcpError

STILL_M_S, STILL_RAD_S = 1e-3, 1e-3
"""Below these a rover counts as standing."""


SAMPLE_S = 0.01
"""Between two lines of a truth file; also the mock's step."""


class NotStill(RoverNcpError):
    """The rover still moves although it should stand."""

    exit_code = 1


class Motion(NamedTuple):
    """One line of a truth file: when (simulation clock and since the epoch, in ns), place in m, speeds in m/s
    and rad/s."""

    clock_ns: int
    wall_ns: int
    x: float
    y: float
    v: float
    omega: float

    @property
    def moving(self) -> bool:
        """Whether the rover moves."""
        return abs(self.v) > STILL_M_S or abs(self.omega) > STILL_RAD_S


class TruthReader:
    """Reads a truth file that a running mock goes on writing; ``rows`` are all so far."""

    def __init__(self, path: Path) -> None:
        self._file: TextIO = path.open(newline="")
        self._columns: list[str] = []
        self._rest = ""
        self.rows: list[Motion] = []

    def read(self) -> list[Motion]:
        """Read new rows, and return all rows."""
        text = self._rest + self._file.read()
        whole = text.rfind("\n") + 1
        self._rest = text[whole:]
        for values in csv.reader(text[:whole].splitlines()):
            if not self._columns:
                self._columns = values
                continue
            row = dict(zip(self._columns, values, strict=True))
            numbers = (float(row[name]) for name in ("x", "y", "v", "omega"))
            self.rows.append(Motion(int(row["clock_ns"]), int(row["t_ns"]), *numbers))
        return self.rows

    def since(self, clock_ns: int) -> list[Motion]:
        """Return the rows from a moment of the simulation clock on."""
        rows = self.read()
        return rows[bisect_left(rows, clock_ns, key=lambda row: row.clock_ns) :]

    def moving(self) -> bool:
        """Whether the rover moves, by the newest row."""
        rows = self.read()
        return bool(rows) and rows[-1].moving

    def stood_after(self, since_ns: int, timeout_s: float, still_s: float = 0.3) -> float:
        """Wait until the rover has stood for ``still_s``; return how long after ``since_ns`` it stopped.

        Both times are of the simulation clock, which follows the machine's monotonic clock. The
        rover stands from the first sample on in which it does not move: at most `SAMPLE_S` too late. Zero
        when it never moved. Raises NotStill after ``timeout_s``.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            rows = self.since(since_ns)
            last_ns = next((row.clock_ns for row in reversed(rows) if row.moving), None)
            if rows and rows[-1].clock_ns - (last_ns or since_ns) > still_s * 1e9:
                return 0.0 if last_ns is None else (last_ns - since_ns) * 1e-9 + SAMPLE_S
            if time.monotonic() > deadline:
                raise NotStill(f"the rover still moves {timeout_s:g} s after it should have stopped")
            time.sleep(0.02)

    def close(self) -> None:
        """Close the file."""
        self._file.close()
