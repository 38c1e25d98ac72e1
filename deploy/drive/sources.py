"""Notices a second publisher of the driver's inputs. No I/O, no clock.

The bridge marks its messages with its id. Messages of one publisher have one id, or none. So an id that comes
back after another one shows two publishers: a bridge that restarts has a new id and does not go back.
Publishers without an id look alike; two of them show only if their stamps go back again and again.
"""

from collections import deque

OF_BRIDGE = "odom", "imu"
INPUTS = frozenset({*OF_BRIDGE, "pose"})
"""The topics whose messages the estimate is made of."""
REMEMBERED = 16
"""Ids of each topic that are kept."""
LAST, STEPS_BACK = 20, 4
"""In the last so many messages, stamps may go back less often than this: a clock is set once, and a late
message is an exception."""


class Sources:
    """The publishers of each input; ``second`` has words for what comes from more than one."""

    def __init__(self) -> None:
        self.second: dict[str, str] = {}
        self._seen: dict[str, list[str]] = {}
        self._stamps: dict[str, tuple[int, deque[bool]]] = {}

    def note(self, topic: str, source: str, stamp_ns: int) -> None:
        """Take in a message of an input: the id of its publisher ("" without one), and its stamp."""
        self._note_id(topic, source)
        if topic in OF_BRIDGE:  # a base without a gyro sends no imu: then a false one is the only one
            self._note_id(" and ".join(OF_BRIDGE), source)
        last_ns, backward = self._stamps.get(topic, (stamp_ns, deque[bool](maxlen=LAST)))
        backward.append(stamp_ns < last_ns)
        self._stamps[topic] = stamp_ns, backward
        if sum(backward) >= STEPS_BACK:
            self.second.setdefault(topic, f"two publishers send {topic}, or one sends it out of order")

    def _note_id(self, what: str, source: str) -> None:
        seen = self._seen.setdefault(what, [])
        if source in seen[:-1]:
            self.second.setdefault(what, f"two publishers send {what}")
        elif source not in seen:
            self._seen[what] = [*seen, source][-REMEMBERED:]
