"""The publishers of a drive's inputs: how many there are, and in which namespace. Pure."""

from collections import defaultdict
from collections.abc import Iterator

from rover_ncp.recording.recording import header_stamp_ns
from rover_ncp.wire.key_table import spec

INPUTS = "odom", "imu", "pose"
"""The topics whose messages the estimate is made of."""
STEPS_BACK = 4
"""Stamps that go back so often are of two publishers that have no id."""


class Publishers:
    """Counts the publishers of each input during a check."""

    def __init__(self) -> None:
        self._ids = defaultdict[tuple[str, str], set[str]](set)
        """Ids by namespace and topic; "" is the id of messages without one."""
        self._newest_ns: dict[tuple[str, str], int] = {}
        self._steps_back = defaultdict[tuple[str, str], int](int)

    def note(self, key_expr: str, source: str, data: bytes) -> None:
        """Take in a message; ``source`` is the id of its publisher, "" without one."""
        if (found := _input(key_expr)) is None:
            return
        stamp_ns = header_stamp_ns(spec(found[1]).type, data) or 0
        self._ids[found].add(source)
        self._steps_back[found] += stamp_ns < self._newest_ns.get(found, stamp_ns)
        self._newest_ns[found] = stamp_ns

    def problems(self, namespace: str) -> Iterator[str]:
        """Yield each input of a namespace that has two publishers, in words."""
        ids = {topic: self._ids.get((namespace, topic), set()) for topic in INPUTS}
        for topic in INPUTS:
            if len(ids[topic]) > 1:
                yield f"{len(ids[topic])} publishers send {topic}, expected one"
            elif self._steps_back[namespace, topic] >= STEPS_BACK:
                yield f"two publishers send {topic}, or one sends it out of order"
        if ids["odom"] and ids["imu"] and not ids["odom"] & ids["imu"]:
            yield "odom and imu come from two publishers, expected the bridge for both"

    def elsewhere(self, topic: str, namespace: str) -> list[str]:
        """Return the other namespaces in which an input arrives; "" is that of topics without a prefix."""
        found = [where for where, name in list(self._ids) if name == topic and where != namespace]
        return sorted(found)


def _input(key_expr: str) -> tuple[str, str] | None:
    """Return the namespace and topic of a key expression; None for another topic.

    >>> _input("bot1/odom"), _input("0/bot1/pose/geometry_msgs::msg::dds_::PoseStamped_/RIHS01_1")
    (('bot1', 'odom'), ('bot1', 'pose'))
    """
    parts = key_expr.split("/")
    if parts[-1] in INPUTS:
        return "/".join(parts[:-1]), parts[-1]
    # A node of rmw_zenoh: domain, topic, type, hash of the type. The bridge sends each input so, too.
    if len(parts) >= 4 and parts[-3] == "pose" and parts[0].isdigit():
        return "/".join(parts[1:-3]), "pose"
    return None
