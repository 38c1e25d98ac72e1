"""Speeds in SI to the whole mm/s and deg/s that a base takes, right on average.

A degree a second is a tenth of the parking turn rate, too coarse to round. The remainder of a turn command is
carried over, so that the angle turned stays within a fraction of a degree of the commanded angle and the mean
over a second within 0.002 rad/s. A zero command sends zero and carries nothing over.
"""

import math
from dataclasses import dataclass

STANDING_M_S = 0.002
STANDING_RAD_S = 0.002
"""Dead band: commands within both ask for a standing rover. Its width is the mean error that is allowed."""

HOLD_S = 0.05
"""Least duration of a turn setpoint, unless the command changes."""

_MAX_HOLD_S = 0.25
_EARLY_S = 0.002
"""Tolerance for a loop at 20 Hz that runs a little early; without it half of its ticks would be lost."""


@dataclass(frozen=True)
class MotionLimits:
    """Limits set in the base: m/s, rad/s, m/s², rad/s². Accelerations: the paper's simulator."""

    v: float = 0.3
    omega: float = 0.6
    accel: float = 0.31
    decel: float = 0.31
    alpha: float = 1.25
    alpha_decel: float = 1.25

    @property
    def v_mm_s(self) -> int:
        """The speed limit as SETV carries it."""
        return math.ceil(self.v * 1000 - 1e-6)

    @property
    def omega_deg_s(self) -> int:
        """The turn limit as SETRV carries it: the whole degree a second above it."""
        return math.ceil(math.degrees(self.omega) - 1e-6)


class SetPoints:
    """The command in force and the integers that carry it, one ``step`` per turn of the bridge's loop."""

    def __init__(self, limits: MotionLimits) -> None:
        self.limits = limits
        self._command = self._stepped = (0.0, 0.0)
        self._chosen = (0, 0)
        self._chosen_s = self._stepped_s = -math.inf
        # Angle that was commanded but not sent, in rad.
        self._owed = 0.0

    def command(self, v: float, omega: float) -> None:
        """Take over a command in m/s and rad/s, held within the limits. Raises ValueError if not finite."""
        if not (math.isfinite(v) and math.isfinite(omega)):
            raise ValueError(f"a command must be finite, got v={v}, omega={omega}")
        limits = self.limits
        self._command = (
            min(max(v, -limits.v), limits.v),
            min(max(omega, -limits.omega), limits.omega),
        )

    def zero(self) -> None:
        """Command zero and drop the remainder."""
        self._command = self._stepped = (0.0, 0.0)
        self._chosen = (0, 0)
        self._owed = 0.0

    def step(self, now: float) -> tuple[int, int]:
        """Return VEL (mm/s) and RVEL (deg/s) that stand for the command from ``now`` on."""
        # The last step's setpoint has been in force since then, for the command of the last step.
        elapsed = min(now - self._stepped_s, _MAX_HOLD_S)
        missed = self._stepped[1] - math.radians(self._chosen[1])
        self._owed += missed * elapsed
        changed = self._command != self._stepped
        self._stepped, self._stepped_s = self._command, now
        v, omega = self._command
        if abs(v) < STANDING_M_S and abs(omega) < STANDING_RAD_S:
            self.zero()
        elif changed or now - self._chosen_s >= HOLD_S - _EARLY_S:
            hold = min(max(now - self._chosen_s, HOLD_S), _MAX_HOLD_S)
            wanted = math.degrees(omega + self._owed / hold)
            limit = self.limits.omega_deg_s
            self._chosen = (round(v * 1000), min(max(round(wanted), -limit), limit))
            self._chosen_s = now
        return self._chosen
