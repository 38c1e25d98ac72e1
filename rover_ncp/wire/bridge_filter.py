"""Whether a message on a topic of the bridge comes from the bridge or from another peer. Pure."""

from collections.abc import Callable, Collection

from rover_ncp.wire.key_table import BRIDGE, KeySpec


class BridgeFilter:
    """Accepts the messages that only a bridge sends from the process at the address alone.

    ``connected`` returns the ids of that process. Behind a router the bridge has another id: until a message
    of the process at the address comes, those of all peers count.
    """

    def __init__(self, connected: Callable[[], Collection[object]]) -> None:
        self._look_up = connected
        self._connected: Collection[object] = ()
        self._is_bridge = False
        """Whether the process at the address has sent a message that only a bridge sends."""

    def accepts(self, row: KeySpec, source: object | None) -> bool:
        """Return whether a message of the peer ``source`` counts; None is a peer that states no id."""
        if row.senders != BRIDGE or row.latched:
            return True
        if source is not None and source not in self._connected:
            self._connected = self._look_up()
        if source in self._connected:
            self._is_bridge = True
        return source in self._connected or not self._is_bridge
