"""The rows of the safety matrix: every fault, and how soon the rover must stand after it.

The one table behind ``docs/safety.md``, the tests of the matrix and ``rover-ncp soak``: a row that is added
here and missing in one of them fails a test.
"""

from typing import NamedTuple

from sim.faults.outlet import GONE, PIPE, TERMINAL

STOP_S, WATCHDOG_S = 0.5, 2.0
"""The first safety requirement, and the base's own watchdog."""
LOW_BATTERY_S = 2.0
"""How long the voltage must be low before it counts: it sags when the motors start."""
BRAKING_M_S2, ALPHA_RAD_S2, DELAY_S = 0.31, 1.25, 0.15
"""The mock's, as a Pioneer's: what "plus braking" means."""


class Row(NamedTuple):
    """A fault of a layer; the rover stands within ``bound_s`` plus braking."""

    key: str
    layer: str
    fault: str
    bound_s: float = STOP_S
    outside: bool = True
    """Whether it can be injected into running processes, and so belongs into a soak."""
    outlet: str = ""
    """The kind of `Outlet` that takes the bridge's output, which stops just before the fault."""

    @property
    def allowed(self) -> str:
        """The bound in words."""
        return f"{WATCHDOG_S:g} s + {STOP_S:g} s" if self.bound_s > WATCHDOG_S else f"{self.bound_s:g} s"


_OUTLETS = {
    TERMINAL: "the bridge's terminal stopped (Ctrl-S)",
    PIPE: "the bridge's pipe full",
    GONE: "the bridge's reader gone",
}
_WITH_OUTLET = {
    "bumper": "bumper",
    "stall": "stall",
    "stop-button": "stop button",
    "stop-query": "`rover/stop`",
    "silence": "no more commands",
}

MATRIX: tuple[Row, ...] = (
    Row("odometry-frozen", "base", "odometry frozen, SIPs go on"),
    Row("odometry-jumps", "base", "odometry jumps by 0.5 m"),
    Row("odometry-nan", "base", "odometry not a number, between the base's own"),
    Row("mute", "base", "mute (no SIPs)"),
    Row("bumper", "base", "bumper"),
    Row("stall", "base", "stall"),
    Row("stop-button", "base", "stop button"),
    Row("low-battery", "base", "low battery (2 s below 11 V)", LOW_BATTERY_S + STOP_S),
    Row("restart", "base", "restarts"),
    Row("wall", "base", "a wall within `sonar_stop_m`", outside=False),
    Row("line-reset", "line", "to the base cut by a TCP reset", WATCHDOG_S),
    Row("line-pulled", "line", "to the base pulled: nothing comes, nothing goes", WATCHDOG_S),
    Row("deploy-killed", "deploy", "killed (SIGKILL)"),
    Row("deploy-stopped", "deploy", "stopped (SIGSTOP)"),
    Row("deploy-hung", "deploy", "hung, the interpreter's lock held"),
    Row("deploy-held", "link", "deploy's link held back"),
    Row("link-late", "link", "commands 5 s late, all arrive"),
    Row("link-cut", "link", "cut"),
    Row("link-slow", "link", "slow: 1 kB/s, commands later and later"),
    Row("link-held-first", "link", "held back before the first command"),
    Row("not-a-number", "command", "not a number"),
    Row("infinite", "command", "infinite"),
    Row("truncated", "command", "truncated"),
    Row("oversized", "command", "oversized"),
    Row("another-type", "command", "of another type"),
    Row("no-type", "command", "of no type"),
    Row("clock-back", "command", "stamped an hour ago"),
    Row("foreign", "command", "a foreign publisher goes on"),
    Row("flood", "command", "a flood of commands"),
    Row("bridge-stopped", "bridge", "stopped (SIGSTOP)", WATCHDOG_S),
    Row("bridge-hung", "bridge", "hung, the interpreter's lock held", WATCHDOG_S),
    Row("bridge-killed", "bridge", "killed (SIGKILL)", WATCHDOG_S),
    *(
        Row(f"{outlet}-{fault}", "output", f"{state}, then {words}", outlet=outlet)
        for outlet, state in _OUTLETS.items()
        for fault, words in _WITH_OUTLET.items()
    ),
)

_BY_KEY = {row.key: row for row in MATRIX}


def row(key: str) -> Row:
    """Return a row of the matrix. KeyError for a key that is not in it."""
    return _BY_KEY[key]


def braking_s(v: float, omega: float = 0.0) -> float:
    """Return how long the base takes to stand, in s, from a speed in m/s and a turn rate in rad/s."""
    return DELAY_S + max(abs(v) / BRAKING_M_S2, abs(omega) / ALPHA_RAD_S2)
