"""Messages of a robot's topics that cannot be used: why and how many, for the log and for a hold. Pure."""

from collections.abc import Callable
from dataclasses import dataclass

NOTICE_S = 1.0
"""A topic is named in the log after this time without a message that can be used."""
AGAIN_S = 60.0
"""Shortest time between two lines on one topic."""


@dataclass
class _Topic:
    total: int = 0
    in_row: int = 0
    reason: str = ""
    since_s: float = 0.0
    """When the first of those in a row arrived."""
    named_s: float | None = None
    """When the log named the topic last."""
    named: bool = False
    """Whether it named those in a row."""


class UnusedMessages:
    """Counts by topic; ``name`` returns a topic's full name."""

    def __init__(self, name: Callable[[str], str]) -> None:
        self._name = name
        self._topics: dict[str, _Topic] = {}

    def add(self, topic: str, reason: str, now: float) -> None:
        """Take a message that cannot be used."""
        found = self._topics.setdefault(topic, _Topic())
        if not found.in_row:
            found.since_s, found.named = now, False
        found.total, found.in_row, found.reason = found.total + 1, found.in_row + 1, reason

    def end(self, topic: str) -> None:
        """Note that a message can be used."""
        if topic in self._topics:
            self._topics[topic].in_row = 0

    def words(self, topic: str) -> str:
        """Return why the newest messages of a topic cannot be used, and how many; "" if they can."""
        found = self._topics.get(topic)
        if found is None or not found.in_row:
            return ""
        messages = "1 message" if found.in_row == 1 else f"{found.in_row} messages"
        return f"{messages} on {self._name(topic)} cannot be used: {found.reason}"

    def notices(self, now: float, but: str) -> list[str]:
        """Return the lines for the log that are due: one for each topic that sends nothing to be used.

        ``but`` is left out: its loss ends the lease and is named then.
        """
        lines = []
        for topic, found in self._topics.items():
            quiet = found.named_s is not None and now - found.named_s < AGAIN_S
            due = found.in_row and not found.named and not quiet and topic != but
            if due and now - found.since_s >= NOTICE_S:
                found.named, found.named_s = True, now
                lines.append(self.words(topic))
        return lines

    @property
    def topics(self) -> list[str]:
        """Topics whose newest message cannot be used."""
        return [topic for topic, found in self._topics.items() if found.in_row]

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages that could not be used, by topic, for diagnostics."""
        return {f"{self._name(topic)}: not used": found.total for topic, found in self._topics.items()}
