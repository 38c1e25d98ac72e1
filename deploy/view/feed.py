"""Updates of a running drive: the changes since a viewer's last request, ready for its page.

One feed serves any number of viewers, each with its own `Cursor`. A new viewer, and every viewer after a
new drive has begun, gets everything. Messages come from one thread, requests of viewers from others. Rows of
a drive are only ever appended, so columns are made outside the lock that messages need.
"""

import threading
from base64 import b64encode
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from markupsafe import Markup, escape

from deploy.view.page import fragment
from deploy.view.page_data import columns, event_rows
from deploy.view.recorded_drive import KINDS, facts
from deploy.view.timeline import STAGES, Timeline, read_jpeg
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import FormatError
from rover_ncp.course.course import Course
from rover_ncp.course.scoring import Parked
from rover_ncp.recording.recording import Recorded
from rover_ncp.wire.key_table import TAG_VIEW
from rover_ncp.wire.messages import read_text
from rover_ncp.wire.protocol import DriverStatus, in_words, parse_json

FINAL = frozenset({*map(str, Parked), "ended", "fault"})
"""States of a driver whose drive has ended."""
FIRST = frozenset({"waiting", "searching", "armed"})
"""States of a driver before its drive; it may be refused the motors, and then ends without another status."""
BEFORE = 50
"""Odometry, commands and voltages kept before a drive begins."""
SILENT_NS = 5_000_000_000
"""A driver that has not ticked for so long was killed: what comes then belongs to no drive."""


@dataclass
class Cursor:
    """What a viewer has received: rows of each stream, and the text of each part of the page."""

    drive: str | None = None
    """The id of the drive; None before the first updates."""
    rows: Counter[str] = field(default_factory=Counter)
    html: dict[str, Markup] = field(default_factory=dict)
    view: str = ""
    """The picture of tags, as base64."""


class Feed:
    """The newest drive of a robot."""

    def __init__(self, policy: Policy, course: Course) -> None:
        self._policy, self._course = policy, course
        self._lock = threading.Lock()
        self._drive = ""
        """The id of the drive."""
        self._view = ""
        """The newest picture of tags, a JPEG as base64; it belongs to no drive."""
        self._elsewhere: bool
        """Whether the drive has another course, so that the page's says nothing of it."""
        self._timeline: Timeline
        self._begin("")

    def take(self, message: Recorded) -> None:
        """Process a message of the robot, of its driver or of a localiser."""
        if message.topic == TAG_VIEW:
            self._view = b64encode(read_jpeg(message.data)).decode()
            return
        with self._lock:
            if message.topic == "rover/status" and not self._is_of_the_drive(message):
                return
            if self._belongs_to_no_drive(message):
                return
            self._timeline.take(message)
            timeline = self._timeline
            if not timeline.ticks:
                for rows in (timeline.odometry, timeline.commands, timeline.setpoints, timeline.voltages):
                    del rows[:-BEFORE]

    def updates(self, cursor: Cursor, bridge: bool = True) -> dict[str, Any]:
        """Return the new data for a viewer and advance its cursor; ``bridge`` is False without a bridge."""
        with self._lock:
            timeline = self._timeline
            reset = cursor.drive != self._drive
            if reset:
                cursor.__dict__.update(vars(Cursor(self._drive)))
            updates: dict[str, Any] = {
                "reset": reset,
                "status": timeline.status and timeline.status.model_dump(),
                "gate": timeline.gate and timeline.gate.model_dump(),
                "events": event_rows(timeline),
                "elsewhere": self._elsewhere,
            }
            first = cursor.rows
            if timeline.ticks:
                cursor.rows = Counter({name: len(rows) for name, rows in timeline.streams.items()})
            if (view := self._view) != cursor.view:
                updates["view"] = cursor.view = view
            html = self._state_html(bridge)
            updates["html"] = {name: text for name, text in html.items() if cursor.html.get(name) != text}
            cursor.html = html
        return updates | columns(timeline, first, cursor.rows) if cursor.rows else updates

    def _other_than(self, status: DriverStatus) -> str:
        """Return why the drive is not one of this page's policy on its course; "" if it is."""
        if status.state.startswith(STAGES):
            return "a docking has two policies: 'rover-ncp report' shows their currents"
        own = self._policy.circuit.name, self._course.name
        named = status.policy or own[0], status.course or own[1]  # a driver may leave them out
        if named == own:
            return ""
        return f"this page draws policy {own[0]} on course {own[1]}: start watch with --policy and --course"

    def _belongs_to_no_drive(self, message: Recorded) -> bool:
        """Whether a message came after the end of the drive; its data stay unchanged until the next one."""
        if message.topic in {"rover/status", "rover/gate"}:
            return False
        if self._ended or message.topic in {"rover/estimate", "rover/neurons"}:
            return self._ended
        ticks = self._timeline.ticks
        return bool(ticks) and message.log_ns - ticks[-1].wall_ns > SILENT_NS

    def _is_of_the_drive(self, message: Recorded) -> bool:
        """Return whether a status is of the drive, which begins here if another one follows it."""
        try:
            status = parse_json(DriverStatus, read_text(message.data))
        except FormatError:
            return True  # the timeline counts it
        if status.drive != self._drive and self._follows(status):
            self._begin(status.drive)
        if status.drive != self._drive:
            return False
        if status.state.startswith(STAGES) or not self._timeline.other:
            self._timeline.other = self._other_than(status)
            self._elsewhere = status.state.startswith(STAGES) or status.course not in {"", self._course.name}
        return True

    def _follows(self, status: DriverStatus) -> bool:
        """Return whether the drive of a status follows this one. A driver that waits may be refused."""
        if self._ended:
            return status.state not in FINAL
        return not self._timeline.ticks or status.state not in FIRST | FINAL

    @property
    def _ended(self) -> bool:
        status = self._timeline.status
        return status is not None and status.state in FINAL

    def _begin(self, drive: str) -> None:
        self._drive = drive
        self._elsewhere = False
        self._timeline = Timeline(self._policy, self._course)

    def _state_html(self, bridge: bool) -> dict[str, Markup]:
        """Return the parts of the page that change with the states of driver and gate."""
        timeline, notes = self._timeline, []
        status, gate = timeline.status, timeline.gate
        state = (status.state if status else "waiting") if bridge else "no bridge"
        kind = {**KINDS, "fault": "bad", "no bridge": "bad"}.get(state, "")
        if status:
            notes.append(f"policy {status.policy} on course {status.course}")
        if gate and gate.lease:
            notes.append(f"{gate.driver_name or 'a driver without a name'} holds the lease")
            notes += [f"the gate holds the rover, {in_words(gate.held)}"] if gate.held else []
        elif gate:
            notes.append("no driver holds the lease")
        if timeline.other:
            notes.append(timeline.other)
        elif timeline.foreign:
            notes.append(
                "the driver's neurons are not those of this page's policy: start watch with --policy"
            )
        return {
            "title": fragment("title", state, kind, status.reason if status else ""),
            "subline": escape("; ".join(notes)),
            "summary": fragment("rows", facts(timeline, {} if self._ended else None)),
            "events": fragment("events", event_rows(timeline)),
        }
