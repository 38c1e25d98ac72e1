"""Whether the rover follows its commands, by odometry.

Frozen odometry, blocked wheels that the base does not notice, and a hold of the gate all look the same: the
rover does not follow its commands. The check covers a second of commands, after the time for the base's delay
and acceleration: 0.15 s and 0.5 s to full speed, or almost none. A short burst of commands may be over long
before the end of the longer time, so only motion that was commanded under both assumptions counts.
"""

from collections import deque

from rover_ncp.core.geometry import Velocity
from rover_ncp.course.course import TICK_S

WINDOW_TICKS = round(1.0 / TICK_S)
LAG_TICKS = round(0.7 / TICK_S)
SHORTEST_LAG_TICKS = round(0.1 / TICK_S)
ASKED_MIN_M = 0.05
ASKED_MIN_RAD = 0.10
"""Commanded motion within the window below these may be lost in the base's whole mm/s and deg/s."""
FOLLOWED_MIN = 0.1
"""The share of the commanded motion that the rover must have driven."""


class ResponseWatch:
    """Compares each tick's command with the estimated motion."""

    def __init__(self) -> None:
        self._asked: deque[Velocity] = deque(maxlen=WINDOW_TICKS + LAG_TICKS)
        self._driven: deque[Velocity] = deque(maxlen=WINDOW_TICKS)

    def tick(self, asked: Velocity, driven: Velocity) -> str:
        """Return the motion that is missing, "" if none is. ``driven`` is the motion before this command."""
        self._driven.append(driven)
        complaint = ""
        if len(self._asked) == self._asked.maxlen:
            commands, latest = list(self._asked), LAG_TICKS - SHORTEST_LAG_TICKS
            windows = commands[:WINDOW_TICKS], commands[latest : latest + WINDOW_TICKS]
            for name, unit, least in (("v", "m", ASKED_MIN_M), ("omega", "rad", ASKED_MIN_RAD)):
                # Commands to and fro may cancel out; motion either way shows that something is followed.
                wanted = TICK_S * min(
                    abs(sum(getattr(command, name) for command in window)) for window in windows
                )
                got = sum(abs(getattr(motion, name)) for motion in self._driven) * TICK_S
                if wanted >= least and got < FOLLOWED_MIN * wanted:
                    complaint = f"{got:.3f} {unit} where {wanted:.3f} {unit} were commanded within a second"
        self._asked.append(asked)
        return complaint
