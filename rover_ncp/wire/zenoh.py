"""Settings of every Zenoh client in this project; the values are measured."""

from typing import Any

CLIENT: dict[str, Any] = {
    "mode": "client",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    # How long we may be silent before the other side drops us; it must be announced by the silent side.
    "transport/link/tx/lease": 1000,
    "transport/link/tx/keep_alive": 4,
    "transport/shared_memory/enabled": False,
    # Microseconds; by default a message that cannot leave at once blocks its sender for 1 ms.
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
    "connect/timeout_ms": 2000,
    # The default waits up to 4 s between attempts, which made reconnecting as slow.
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
}
