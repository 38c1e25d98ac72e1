"""A row of the safety matrix: a fault, how it is injected, and how soon the rover must stand."""

from collections.abc import Callable
from typing import NamedTuple

from faults.rig import Scene
from faults.scripted_driver import NAME

STOP_S, WATCHDOG_S = 0.5, 2.0
"""The first safety requirement, and the base's own watchdog."""
LOW_BATTERY_S = 2.0
"""How long the voltage must be low before it counts: it sags when the motors start."""
BRAKING_M_S2, ALPHA_RAD_S2, DELAY_S = 0.31, 1.25, 0.15
"""The mock's, as a Pioneer's: what "plus braking" means."""
CIRCUIT, SCRIPTED = "circuit", NAME
"""The drivers."""


Act = Callable[[Scene], int | None]


class Row(NamedTuple):
    """A fault of a layer."""

    key: str
    layer: str
    fault: str
    act: Act | None = None
    """Injects the fault into running processes. Returns when it began, in ns of the monotonic clock, or None
    for the time of its call."""
    mend: Callable[[Scene], object] = lambda scene: None
    """Removes the fault; by default it ends by itself."""
    ended: str = ""
    """The reason for which the gate ends the lease, if it always does."""
    only: str = ""
    """The only driver under which the fault can be injected, if not both."""
    requests_lease: bool = True
    """Whether a scripted driver requests the lease again. False where the gate would grant it at once."""
    lease_s: float = 1.0
    """Zenoh lease of a scripted driver."""
    from_rest: bool = False
    """Whether the rover stands when the fault begins."""
    outlet: str = ""
    """The kind of `Outlet` that takes the bridge's output, which stops just before the fault."""

    @property
    def drivers(self) -> tuple[str, ...]:
        """The drivers under which the fault can be injected."""
        return (self.only,) if self.only else (SCRIPTED, CIRCUIT)

    @property
    def link_fault(self) -> bool:
        """Whether the fault is on the driver's own link, which then goes through the proxy."""
        return self.layer == "link"

    @property
    def losing(self) -> bool:
        """Whether the driver may miss messages once the fault has begun."""
        return self.layer in {"deploy", "link", "bridge"}

    @property
    def bound_s(self) -> float:
        """The rover stands within this time plus braking."""
        if self.layer in {"line", "bridge"}:
            return WATCHDOG_S
        return STOP_S + (LOW_BATTERY_S if self.key == "low-battery" else 0.0)

    @property
    def allowed(self) -> str:
        """The bound in words."""
        return f"{WATCHDOG_S:g} s + {STOP_S:g} s" if self.bound_s > WATCHDOG_S else f"{self.bound_s:g} s"


def braking_s(v: float, omega: float = 0.0) -> float:
    """Return how long the base takes to stand, in s, from a speed in m/s and a turn rate in rad/s."""
    return DELAY_S + max(abs(v) / BRAKING_M_S2, abs(omega) / ALPHA_RAD_S2)
