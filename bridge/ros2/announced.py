"""The topics that a robot's side announces, and what they say about a topic on which nothing comes. Pure."""

from collections.abc import Callable

from bridge.ros2.discovery import Announced
from rover_ncp.wire.messages import ODOMETRY

MAX_TOKENS = 1000
"""Announced topics beyond this number are not remembered."""
MAX_NAMES = 8
"""Most topics or types that a text names."""


class AnnouncedTopics:
    """Tokens of others than the session ``zid``; ``name`` returns a topic's full name."""

    def __init__(self, name: Callable[[str], str], zid: str) -> None:
        self._name, self._zid = name, zid
        self._tokens: dict[Announced, None] = {}

    def update(self, token: Announced, there: bool) -> None:
        """Take a token that appeared or is gone."""
        if not there:
            self._tokens.pop(token, None)
        elif len(self._tokens) < MAX_TOKENS and token.zid != self._zid:
            self._tokens[token] = None

    def publishes(self, token: Announced, topic: str) -> bool:
        """Return whether a token is that of another's publisher of a topic."""
        return token.published and token.zid != self._zid and token.topic == self._name(topic)

    def publisher_names(self, topic: str) -> list[str]:
        """Return the names of a topic's publishers, of whatever type."""
        return sorted({found.who for found in self._tokens if self.publishes(found, topic)})

    def publishers(self, topic: str, ros_type: str) -> list[Announced]:
        """Return a topic's publishers of a type."""
        return [
            found for found in self._tokens if self.publishes(found, topic) and found.ros_type == ros_type
        ]

    def other_type(self, topic: str, wanted: str) -> str:
        """Return the types that a topic's subscribers take, if ``wanted`` is none of them."""
        name = self._name(topic)
        types = {found.ros_type for found in self._tokens if found.topic == name and not found.published}
        return "" if wanted in types else ", ".join(sorted(types)[:MAX_NAMES])

    def found_instead(self, topic: str, wanted: str) -> str:
        """Return in words what is announced in place of a topic on which nothing comes."""
        where = self._name(topic)
        elsewhere = {found.topic for found in self._tokens if found.published and found.ros_type == wanted}
        words = f"no message on {where}"
        if problem := self.type_problem(topic, wanted):
            return f"{words}: {problem}"
        if elsewhere - {where}:
            return f"{words}: {wanted} is published on {_listed(elsewhere - {where})}"
        return f"{words}, expected {wanted}"

    def instead_of_odometry(self, topic: str) -> str:
        """Return in words what is announced where no odometry comes."""
        published = {found.topic for found in self._tokens if found.published}
        known = f"published there: {_listed(published)}" if published else "no topic is announced there"
        return f"no {ODOMETRY} arrives on {self._name(topic)}; {known}"

    def type_problem(self, topic: str, wanted: str) -> str:
        """Return in words that a topic is published with another type alone; "" if it is not."""
        types = {found.ros_type for found in self._tokens if self.publishes(found, topic)}
        if not types or wanted in types:
            return ""
        todo = "name a topic of that type in the description"
        return f"it has the type {_listed(types)}, expected {wanted}: {todo}"


def _listed(names: set[str]) -> str:
    return ", ".join(sorted(names)[:MAX_NAMES])
