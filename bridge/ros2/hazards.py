"""A ROS 2 robot's stop button and hazards, which come on topics of their own, between reports of odometry."""

from rover_ncp.core.errors import FormatError
from rover_ncp.robot.description import Topics
from rover_ncp.wire.cdr import decode
from rover_ncp.wire.messages import BOOL, read_hazards


class Hazards:
    """The state by the newest messages, and what was seen since the last report to the gate."""

    def __init__(self, topics: Topics) -> None:
        self._stop = topics.stop
        self.topics = frozenset(topic for topic in (topics.stop, topics.hazards) if topic is not None)
        self.silent = set(self.topics)
        """Topics on which no message came."""
        self.unreadable: dict[str, str] = {}
        """Topics whose last message cannot be read, and why not."""
        self._pressed, self._was_pressed = False, False
        self._present, self._were_present = frozenset[int](), frozenset[int]()

    def take(self, topic: str, payload: bytes) -> None:
        """Take a stop or hazards. Raises FormatError."""
        self.silent.discard(topic)
        try:
            if topic == self._stop:
                self._pressed = bool(decode(BOOL, payload).data)
                self._was_pressed |= self._pressed
            else:
                self._present = read_hazards(payload)
                self._were_present |= self._present
        except FormatError as error:
            self.unreadable[topic] = str(error)
            raise
        self.unreadable.pop(topic, None)

    def since_last(self) -> tuple[bool, frozenset[int]]:
        """Return whether a stop was pressed, and the hazards, since the last call: also those that are over.

        A contact may be shorter than the time between two reports.
        """
        found = self._was_pressed, self._were_present
        self._was_pressed, self._were_present = self._pressed, self._present
        return found
