"""What follows from a break of the line to the base, by the lines of the bridge's log. Pure."""

import re
from dataclasses import dataclass

from rover_ncp.core.bridge_lines import (
    BACK,
    CONNECTED,
    DOCKING,
    GOT_LEASE,
    HAZARD,
    LOST,
    LOST_LEASE,
    RELEASED_LEASE,
    STOP_REQUESTED,
    STOPPED,
)

NOTICE_S = 5.0
"""Time between the announcement of a docking that resumes and its start."""
MAX_RESUMES = 3
SAME_BREAK_S = 2.0
"""Lines of one break come within this time."""
_OF_A_BREAK = re.compile(r"(no-base|odometry)\b")
"""Reasons of the gate when the line to the base fails."""
_DOCKING = re.compile(rf"{DOCKING}([a-z0-9][a-z0-9_-]*){GOT_LEASE}")
"""A driver chooses its name: only that of a place in the robot's folder of places counts."""


@dataclass(frozen=True)
class Begin:
    """A docking at ``place`` resumes, for the ``number``-th time."""

    place: str
    number: int


class LineBreaks:
    """Follows the bridge's log, and says what a person has to do after a line break.

    ``take`` returns the advice that goes with a line; "" for none. With ``resume`` the docking that a break
    alone ended resumes; `due` returns it when its notice is over.
    """

    def __init__(self, *, fenced: bool, resume: bool) -> None:
        self._fenced, self._resume = fenced, resume
        self._connected = False
        self._docking = ""
        """Place of the docking that holds the lease."""
        self._held_s = -SAME_BREAK_S
        """When the gate last held the rover because of the line."""
        self._broken, self._ended_s = "", -SAME_BREAK_S
        """Place of the docking that a break ended, and when."""
        self._begins_s: float | None = None
        self._begun = 0
        self._ours = False
        """Whether a docking that resumed runs."""
        self._starting = ""
        """Its place, while it has no lease yet."""
        self._recalled = False
        """Whether it must end before it drives, because of what has happened since it was started."""

    def take(self, line: str, now_s: float) -> str:
        """Take a line of the bridge's log; return the advice that belongs to it."""
        if line.startswith(LOST):
            self._cancel()
            if now_s - self._ended_s > SAME_BREAK_S:
                self._broken = ""
            return "the rover stands; check power, cable and network: the bridge goes on trying by itself"
        if line == BACK:
            return self._back(now_s)
        if line.startswith(CONNECTED):
            again, self._connected = self._connected, True
            self._forget()
            if not again:
                return ""
            where = "put the rover where the fence begins, end 'rover-ncp up' and start it again, then "
            return f"odometry restarted: {where if self._fenced else ''}start the drive again"
        place = self._broken if self._begins_s is not None else ""
        self._follow(line, now_s)
        return f"the docking at {place} does not resume" if place and not self._broken else ""

    def due(self, now_s: float) -> Begin | None:
        """Return the docking that begins now, once."""
        if self._begins_s is None or now_s < self._begins_s:
            return None
        self._begins_s, self._begun = None, self._begun + 1
        self._ours, self._starting = True, self._broken
        return Begin(self._broken, self._begun)

    def recall(self) -> bool:
        """Return once whether the docking that resumed must end before it drives."""
        recalled, self._recalled = self._recalled, False
        return recalled

    def ended(self) -> None:
        """Note that the docking that resumed is over."""
        self._ours, self._starting, self._recalled = False, "", False

    def _back(self, now_s: float) -> str:
        place = self._broken
        if not place:
            return "odometry went on: start the drive again if one was interrupted"
        if not self._resume:
            return f"start the docking again: rover-ncp deploy --to {place}"
        if self._begun >= MAX_RESUMES:
            return f"the docking at {place} has resumed {MAX_RESUMES} times: repair the line, then start it"
        self._begins_s = now_s + NOTICE_S
        return (
            f"the docking at {place} resumes in {NOTICE_S:g} s ({self._begun + 1} of {MAX_RESUMES}); "
            "'rover-ncp stop' or Ctrl-C prevents it"
        )

    def _follow(self, line: str, now_s: float) -> None:
        if line.endswith(GOT_LEASE):
            found = _DOCKING.fullmatch(line)
            self._docking = found[1] if found else ""
            if self._docking == self._starting:
                self._starting = ""
            if not self._ours:
                self._begun = 0
            self._forget()
        elif STOP_REQUESTED in line or line.startswith(HAZARD):
            self._forget()
        elif line.startswith(STOPPED):
            if _OF_A_BREAK.match(line.removeprefix(STOPPED)):
                self._held_s = now_s
            else:
                self._forget()
        elif self._docking and line.startswith(f"{DOCKING}{self._docking} "):
            self._end(line.removeprefix(f"{DOCKING}{self._docking}"), now_s)

    def _end(self, how: str, now_s: float) -> None:
        lost = how.startswith(LOST_LEASE) and _OF_A_BREAK.match(how.removeprefix(LOST_LEASE))
        # The driver notices old odometry before the gate ends its lease.
        released = how == RELEASED_LEASE and now_s - self._held_s <= SAME_BREAK_S
        if lost or released:
            self._broken, self._ended_s = self._docking, now_s
        self._docking = ""

    def _forget(self) -> None:
        """Forget a docking that a break ended: something else has happened since."""
        self._broken, self._recalled = "", self._recalled or bool(self._starting)
        self._cancel()

    def _cancel(self) -> None:
        self._begins_s = None
