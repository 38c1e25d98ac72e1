"""A ROS 2 robot's stop button and hazards, on topics of their own, between reports of odometry. Pure.

A stop that cannot be received counts as a hazard: nothing is known of it before the first message, after
three periods without one, or when the publisher of a latched topic is gone.
"""

import math
from collections.abc import Callable

from rover_ncp.core.errors import FormatError
from rover_ncp.robot.description import HazardTopic, Topics
from rover_ncp.wire.cdr import decode
from rover_ncp.wire.messages import BOOL, read_hazards


class Hazards:
    """The state by the newest messages, and what was seen since the last report to the gate."""

    def __init__(self, topics: Topics) -> None:
        self._stop = topics.stop.topic if topics.stop else None
        self.topics = {found.topic: found for found in (topics.stop, topics.hazards) if found is not None}
        self._heard_s = dict.fromkeys(self.topics, -math.inf)
        """When the newest message came; −∞ = none that still counts."""
        self._unreadable: dict[str, str] = {}
        """Topics whose last message cannot be read, and why not."""
        self._pressed, self._was_pressed = False, False
        self._present, self._were_present = frozenset[int](), frozenset[int]()

    def take(self, topic: str, payload: bytes, now: float) -> None:
        """Take a stop or hazards. Raises FormatError."""
        try:
            if topic == self._stop:
                self._pressed = bool(decode(BOOL, payload).data)
                self._was_pressed |= self._pressed
            else:
                self._present = read_hazards(payload)
                self._were_present |= self._present
        except FormatError as error:
            self._unreadable[topic] = str(error)
            raise
        self._unreadable.pop(topic, None)
        self._heard_s[topic] = now

    def lose_publisher(self, topic: str) -> None:
        """Forget the message of a latched topic: what its publisher said last may no longer be true."""
        if topic in self.topics and self.topics[topic].latched:
            self._heard_s[topic] = -math.inf

    def unknown(self, now: float, name: Callable[[str], str], announced: Callable[[str], bool]) -> str:
        """Return why it is not known whether there is a hazard; "" if it is.

        ``name`` returns a topic's full name, ``announced`` whether it has a publisher.
        """
        for topic, found in self.topics.items():
            if problem := self._problem(found, now, announced):
                return f"{name(topic)}: {problem}"
        return ""

    def _problem(self, found: HazardTopic, now: float, announced: Callable[[str], bool]) -> str:
        heard_s = self._heard_s[found.topic]
        if found.topic in self._unreadable:
            return f"a message cannot be read: {self._unreadable[found.topic]}"
        if found.latched and not announced(found.topic):
            return "it is latched, and no publisher is announced"
        if heard_s == -math.inf:
            return "no message has come" + (" from its publisher of now" if found.latched else "")
        if now - heard_s > found.max_silence_s:
            return f"no message for {found.max_silence_s:g} s, which is three periods"
        return ""

    def since_last(self) -> tuple[bool, frozenset[int]]:
        """Return whether a stop was pressed, and the hazards, since the last call: also those that are over.

        A contact may be shorter than the time between two reports.
        """
        found = self._was_pressed, self._were_present
        self._was_pressed, self._were_present = self._pressed, self._present
        return found
