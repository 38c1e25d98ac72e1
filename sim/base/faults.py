"""Faults that a mock can inject: ``NAME[=VALUE][@START[-END]]``, as in ``mute@12-14``.

Times are seconds since the motors were first enabled, or since the mock received the fault while it runs. A
fault without a time is active from the beginning.
"""

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass, replace

from rover_ncp.core.errors import UsageError

FAULTS: dict[str, tuple[float, float, float] | None] = {
    "mute": None,  # the base sends nothing
    "deaf": None,  # the base receives nothing
    "corrupt": (0.1, 0.0, 1.0),  # this share of packets, both ways, has a bit flipped
    "drop": (0.1, 0.0, 1.0),  # this share of packets, both ways, loses a byte
    "noise": (0.1, 0.0, 1.0),  # this share of packets, both ways, has bytes before it that belong to none
    "freeze-odometry": None,  # SIPs keep coming, odometry stands
    "jump-odometry": (0.5, -100.0, 100.0),  # x is off by this many metres
    "gyro": (2.0, -1000.0, 1000.0),  # the gyro reads so many rad/s more
    "clock": (-1.0, -1e6, 1e6),  # the clock of a ROS 2 robot is set forward by so many seconds
    "bumper": None,  # a front bumper is pressed
    "stall": None,  # the wheels are blocked and the motors stall
    "stop-button": None,
    "low-battery": (10.5, 0.0, 25.0),  # the battery's voltage
    "reset": None,  # the base restarts, once
}
"""Name: default, least and greatest value; None when it takes none."""

_DAMAGE = ("corrupt", "drop", "noise")


@dataclass(frozen=True)
class Fault:
    """One fault; times in s since the motors were first enabled, None for always."""

    name: str
    value: float = 0.0
    start_s: float | None = None
    end_s: float = math.inf

    def active(self, enabled_s: float | None) -> bool:
        """Return whether it is active ``enabled_s`` after the motors were first enabled (None: not yet)."""
        if self.start_s is None:
            return True
        return enabled_s is not None and self.start_s <= enabled_s < self.end_s


def parse_fault(text: str) -> Fault:
    """Read ``NAME[=VALUE][@START[-END]]``. Raises UsageError with the expected form."""
    what, at, when = text.partition("@")
    name, has_value, value = what.partition("=")
    if name not in FAULTS:
        raise UsageError(
            f"--fault {text}: expected NAME[=VALUE][@START[-END]], NAME one of {', '.join(FAULTS)}"
        )
    value_range = FAULTS[name]
    if has_value and value_range is None:
        raise UsageError(f"--fault {text}: {name} takes no value")
    default, least, greatest = value_range or (0.0, 0.0, 0.0)
    start, until, end = when.partition("-")
    try:
        fault = Fault(
            name,
            float(value) if has_value else default,
            float(start) if at else None,
            float(end) if until else math.inf,
        )
    except ValueError as error:
        raise UsageError(f"--fault {text}: expected numbers in NAME[=VALUE][@START[-END]]") from error
    if not least <= fault.value <= greatest:
        raise UsageError(f"--fault {text}: expected a value from {least:g} to {greatest:g}")
    if not (fault.start_s or 0.0) < fault.end_s:
        raise UsageError(f"--fault {text}: expected an end after the start")
    return fault


class Faults:
    """The faults of one base; the seed decides which packets are damaged."""

    def __init__(self, faults: Sequence[Fault] = (), seed: int = 0) -> None:
        self._faults = list(faults)
        self._random = random.Random(seed)

    def __bool__(self) -> bool:
        return bool(self._faults)

    def add(self, fault: Fault, enabled_s: float | None) -> None:
        """Add a fault; its times count from now, if the motors were ever enabled."""
        began_s = enabled_s or 0.0
        if fault.start_s is not None:
            fault = replace(fault, start_s=fault.start_s + began_s, end_s=fault.end_s + began_s)
        self._faults = [known for known in self._faults if not enabled_s or known.end_s > enabled_s]
        self._faults.append(fault)

    def value(self, name: str, enabled_s: float | None) -> float | None:
        """Return the value of a fault that is active now, else None."""
        for fault in self._faults:
            if fault.name == name and fault.active(enabled_s):
                return fault.value
        return None

    def damage(self, data: bytes, enabled_s: float | None) -> bytes:
        """Return a packet as the line delivers it."""
        damaged = bytearray(data)
        draw = self._random
        for fault in self._faults:
            if fault.name not in _DAMAGE or not fault.active(enabled_s) or not damaged:
                continue
            if draw.random() >= fault.value:
                continue
            place = draw.randrange(len(damaged))
            if fault.name == "corrupt":
                damaged[place] ^= 1 << draw.randrange(8)
            elif fault.name == "drop":
                del damaged[place]
            else:
                damaged[:0] = draw.randbytes(draw.randint(1, 20))
        return bytes(damaged)
