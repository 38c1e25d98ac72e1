"""Live data of a drive: the changes since a viewer's last request, ready for its page.

One feed serves any number of viewers, each with its own place (`Place`). A new viewer, or one that asks after
a new drive has begun, gets everything. Messages come from one thread, requests of viewers from another.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from deploy.report.analysis import analyse
from deploy.report.page.page_data import command_columns, event_rows, findings, frames, moved_columns
from deploy.report.recorded_drive import judge
from deploy.report.timeline import Timeline
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.recording import Recorded
from rover_ncp.course.course import Course

FINAL = frozenset({"parked", "ended", "fault"})
BEFORE = 50
"""Odometry and commands kept while no drive has begun; a page needs no more."""
EXPLAIN_EVERY_S = 1.0


Coverage = tuple[int, bool]
"""Range of an explanation: its number of ticks, and whether it is that of the drive's end."""


@dataclass
class Place:
    """How much of the drive a viewer has received; nothing at first."""

    generation: int = -1
    ticks: int = 0
    odometry: int = 0
    asked: int = 0
    let_through: int = 0
    explained: Coverage = (0, False)


class Feed:
    """The newest drive on a robot."""

    def __init__(self, policy: Policy, course: Course, clock: Callable[[], float] = time.monotonic) -> None:
        self._policy, self._course, self._clock = policy, course, clock
        self._lock = threading.Lock()
        self._generation = 0
        self._timeline = Timeline(policy, course)
        self._over = False
        self._explained: dict[str, Any] = {}
        self._explained_of: Coverage = (0, False)
        self._explained_at = -EXPLAIN_EVERY_S

    def take(self, message: Recorded) -> None:
        """Take in a message of the robot's, or of its driver's."""
        with self._lock:
            timeline = self._timeline
            if self._over and message.topic not in {"rover/status", "rover/gate"}:
                return  # the data of a finished drive stay unchanged until the next one begins
            timeline.take(message)
            if message.topic == "rover/status" and timeline.status is not None:
                state = timeline.status.state
                if self._over and state not in FINAL:
                    self._begin(message)
                self._over = state in FINAL
            if not timeline.ticks:
                del timeline.odometry[:-BEFORE], timeline.asked[:-BEFORE], timeline.let_through[:-BEFORE]

    def news(self, place: Place) -> dict[str, Any]:
        """Return the new data for a viewer, and move its place on."""
        with self._lock:
            reset = place.generation != self._generation
            if reset:
                place.__dict__.update(vars(Place(generation=self._generation)))
            news: dict[str, Any] = {"reset": reset, **self._state()}
            if self._timeline.began_ns is not None:
                news |= self._columns(place)
            return news

    def _begin(self, message: Recorded) -> None:
        self._generation += 1
        self._timeline = Timeline(self._policy, self._course)
        self._timeline.take(message)
        self._explained, self._explained_of = {}, (0, False)

    def _state(self) -> dict[str, Any]:
        status, gate = self._timeline.status, self._timeline.gate
        return {
            "status": None if status is None else status.model_dump(),
            "gate": None if gate is None else gate.model_dump(),
            "verdict": self._verdict() if self._over and self._timeline.ticks else None,
            "foreign": self._timeline.foreign,
            "events": event_rows(self._timeline),
        }

    def _verdict(self) -> str:
        verdict = judge(self._timeline)[-1].verdict
        where = f"{1000 * verdict.error_m:.0f} mm and {1000 * verdict.error_rad:.0f} mrad from the goal"
        return f"{where}, by the estimate"

    def _columns(self, place: Place) -> dict[str, Any]:
        timeline = self._timeline
        ticks, odometry = timeline.ticks[place.ticks :], timeline.odometry[place.odometry :]
        asked, let_through = timeline.asked[place.asked :], timeline.let_through[place.let_through :]
        columns: dict[str, Any] = {
            "ticks": frames(timeline, ticks),
            "odometry": moved_columns(timeline, odometry, on_course=True),
            "asked": command_columns(timeline, asked),
            "letThrough": command_columns(timeline, let_through),
        }
        place.ticks, place.odometry = len(timeline.ticks), len(timeline.odometry)
        place.asked, place.let_through = len(timeline.asked), len(timeline.let_through)
        self._explain()
        if self._explained_of > place.explained:
            columns["findings"] = self._explained
            place.explained = self._explained_of
        return columns

    def _explain(self) -> None:
        """Explain the drive so far, once a second and at its end."""
        count, now = len(self._timeline.ticks), self._clock()
        if (count, self._over) == self._explained_of or count < 2:
            return
        if not self._over and now - self._explained_at < EXPLAIN_EVERY_S:
            return
        explained = findings(analyse(self._timeline.trace()))
        if not self._over:
            explained = {name: explained[name] for name in ("phases", "rings")}
        self._explained, self._explained_of, self._explained_at = explained, (count, self._over), now
