"""A ROS 2 robot's stop button and hazards, on topics of their own, between reports of odometry. Pure.

A stop that cannot be received counts as a hazard: nothing is known of it before the first message, after
three periods without one, or when the publisher of a latched topic is gone. With two publishers, of which one
may say that the button is pressed and the other that it is not, nothing is known either.
"""

import math
from collections.abc import Callable, Sequence

from bridge.ros2.announced import MAX_NAMES
from bridge.ros2.discovery import Announced
from rover_ncp.core.errors import FormatError
from rover_ncp.robot.topics import HazardTopic, Topics
from rover_ncp.wire.cdr import decode
from rover_ncp.wire.messages import BOOL, read_hazards


class Hazards:
    """The state by the newest messages, and what was seen since the last report to the gate."""

    def __init__(self, topics: Topics) -> None:
        self._stop = topics.stop.topic if topics.stop else None
        self.topics = {found.topic: found for found in (topics.stop, topics.hazards) if found is not None}
        self._sources: dict[str, dict[bytes | None, float]] = {topic: {} for topic in self.topics}
        """When the newest message of each publisher came that still counts; None: the form names none."""
        self._pressed_s = -math.inf
        self._unreadable: dict[str, str] = {}
        """Topics whose last message cannot be used, and why not."""
        self._newest: tuple[bytes | None, int] = None, 0
        """Publisher and stamp of the newest hazards."""
        self._pressed, self._was_pressed = False, False
        self._present, self._were_present = frozenset[int](), frozenset[int]()

    def take(self, topic: str, payload: bytes, now: float, source: bytes | None = None) -> None:
        """Take a stop or hazards from a publisher. Raises FormatError."""
        repeated = False
        try:
            if topic == self._stop:
                self._press(bool(decode(BOOL, payload).data), now)
            else:
                self._present, stamp_ns = read_hazards(payload)
                self._were_present |= self._present
                newest, self._newest = self._newest, (source, stamp_ns)
                repeated = stamp_ns != 0 and newest == self._newest
        except FormatError as error:
            self.reject(topic, str(error))
            raise
        self._unreadable.pop(topic, None)
        if repeated:  # its publisher may hang behind a node that sends its last message again and again
            return
        sources, found = self._sources[topic], self.topics[topic]
        sources[source] = now
        if not found.latched:
            for other in [each for each, heard_s in sources.items() if now - heard_s > found.max_silence_s]:
                del sources[other]

    def reject(self, topic: str, problem: str) -> None:
        """Note why a message cannot be used."""
        self._unreadable[topic] = problem

    def _press(self, pressed: bool, now: float) -> None:
        """Take a stop button; a periodic one is released after three periods without a message of a press.

        So a second publisher behind the same bridge of ROS 2 cannot release it.
        """
        if pressed:
            self._pressed_s = now
        found = self.topics[self._stop or ""]
        self._pressed = pressed or (not found.latched and now - self._pressed_s <= found.max_silence_s)
        self._was_pressed |= self._pressed

    def lose_publisher(self, topic: str, source: bytes | None) -> None:
        """Forget a publisher's message on a latched topic: what it said last may no longer be true."""
        if topic in self.topics and self.topics[topic].latched:
            self._sources[topic].pop(source, None)

    def unknown(
        self, now: float, name: Callable[[str], str], publishers: Callable[[str], Sequence[Announced]]
    ) -> str:
        """Return why it is not known whether there is a hazard; "" if it is.

        ``name`` returns a topic's full name, ``publishers`` those that are announced.
        """
        for topic, found in self.topics.items():
            if problem := self._problem(found, now, publishers(topic)):
                return f"{name(topic)}: {problem}"
        return ""

    def _problem(self, found: HazardTopic, now: float, publishers: Sequence[Announced]) -> str:
        sources = self._sources[found.topic]
        heard_s = max(sources.values(), default=-math.inf)
        if found.topic in self._unreadable:
            return f"a message cannot be used: {self._unreadable[found.topic]}"
        if len(publishers) > 1 or len(sources) > 1:
            names = ", ".join(sorted({each.who for each in publishers})[:MAX_NAMES]) or "none is announced"
            return f"it has {max(len(publishers), len(sources))} publishers ({names}), expected one"
        if found.latched and not publishers:
            return "it is latched, and no publisher is announced"
        if heard_s == -math.inf:
            return "no message has come" + (" from its publisher of now" if found.latched else "")
        if now - heard_s > found.max_silence_s:
            return f"no new message for {found.max_silence_s:g} s, which is three periods"
        return ""

    def since_last(self) -> tuple[bool, frozenset[int]]:
        """Return whether a stop was pressed, and the hazards, since the last call: also those that are over.

        A contact may be shorter than the time between two reports.
        """
        found = self._was_pressed, self._were_present
        self._was_pressed, self._were_present = self._pressed, self._present
        return found
