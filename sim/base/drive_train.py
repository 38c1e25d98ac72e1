"""How a base turns setpoints into motion, and motion into odometry.

Translation follows a speed or a distance (MOVE), rotation a rate or a heading (HEAD); the latest command of
each kind counts, VEL2 replaces both. Speeds are held within SETV and SETRV, the rover keeps the acceleration
limits and its own delays. Wheels that push against something stall: their motors rest, then try again (AROS
manual p. 28). Sources: AROS manual p. 44 (which command replaces which), Adept manual p. 38 (VEL2).
"""

import math

from rover_ncp.core.geometry import Pose, Velocity, wrap_angle
from rover_ncp.robot.description import RobotDescription
from sim.base.trial import BaseTrial
from sim.world.rover import STILL_M_S, SUBSTEP_S, Rover

DISTANCE_GAIN, HEADING_GAIN = 2.0, 3.0
"""Speed per way left, in 1/s: a third of what would overshoot with the rover's delays."""

DISTANCE_DONE_M, HEADING_DONE_RAD = 0.002, 0.005

BRAKING_SHARE = 0.5
"""How much of the deceleration limit a MOVE or HEAD plans with."""

E_STOP_DECEL, E_STOP_ALPHA = 5.0, 20.0
"""Braking beyond the deceleration limit, m/s² and rad/s² (chosen)."""

STALL_WHEEL_M_S, STALL_SHARE, STALL_AFTER_S, STALL_REST_S = 0.02, 0.25, 0.15, 0.2
"""A wheel asked for 20 mm/s or more that does not reach a quarter of it for 0.15 s stalls (chosen)."""


class DriveTrain:
    """The motors and wheels of one base. Speeds in m/s and rad/s, headings in rad in the odometry's frame."""

    def __init__(self, robot: RobotDescription, rover: Rover, trial: BaseTrial) -> None:
        self.rover = rover
        self._trial = trial
        self.enabled = False
        self.odometry = Pose(0.0, 0.0, 0.0)
        self.wheels_m = (0.0, 0.0)
        """Way of the left and the right wheel since power-up."""
        self.stalled = (False, False)
        """Left and right motor."""
        self._half_track = robot.half_track_m
        self._way_left: float | None = None
        self._heading: float | None = None
        self._commanded: tuple[float, float] | None = None
        """The setpoints in force; None while the motors are off or rest."""
        self._driven = 0.0, 0.0
        """The motion that they led to."""
        self._pushing_s = self._resting_s = 0.0
        self.restore_flash()

    def restore_flash(self) -> None:
        """Go back to the limits of power-up, standing still."""
        model = self.rover.model
        self.v_limit, self.omega_limit = model.v_max, model.omega_max
        self.limits = {
            "accel": model.accel,
            "decel": model.decel,
            "alpha": model.alpha,
            "alpha_decel": model.alpha_decel,
        }
        self.rover.change_limits(**self._real(self.limits))
        self._braking = False
        self.stop()

    # Commands.

    def set_limit(self, **limit: float) -> None:
        """Change accel, decel (m/s²), alpha or alpha_decel (rad/s²)."""
        self.limits |= limit
        if not self._braking:
            self.rover.change_limits(**self._real(limit))

    def set_speed(self, v: float) -> None:
        """VEL."""
        if self._obeys:
            self._v, self._way_left = v, None

    def set_turn(self, omega: float) -> None:
        """RVEL, ROTATE."""
        if self._obeys:
            self._omega, self._heading = omega, None

    def move(self, way: float) -> None:
        """MOVE: so many metres from here."""
        if self._obeys:
            self._v, self._way_left = 0.0, way

    def turn_to(self, heading: float) -> None:
        """HEAD, DHEAD, DCHEAD: a heading to take and keep."""
        if self._obeys:
            self._omega, self._heading = 0.0, wrap_angle(heading)

    def stop(self) -> None:
        """STOP: zero setpoints."""
        self._v = self._omega = 0.0
        self._way_left = self._heading = None

    def emergency_stop(self) -> None:
        """E_STOP: stop beyond the deceleration limit; commands count again when the base stands."""
        self.stop()
        self._braking = True
        self.rover.change_limits(decel=E_STOP_DECEL, alpha_decel=E_STOP_ALPHA)

    def enable(self, on: bool) -> None:
        """ENABLE: setpoints never outlive it."""
        self.enabled = on
        self.stop()

    def zero_odometry(self) -> None:
        """SETO."""
        self.odometry = Pose(0.0, 0.0, 0.0)
        if self._heading is not None:
            self._heading = 0.0

    def place(self, pose: Pose) -> None:
        """Put the rover somewhere; odometry does not notice."""
        self.rover.set_pose(pose)
        self._commanded = None

    # State.

    @property
    def heading_setpoint(self) -> float:
        """The commanded heading, or the present one."""
        return self.odometry.theta if self._heading is None else self._heading

    @property
    def measured(self) -> Velocity:
        """The motion as the base measures it: the encoders', with the trial's errors."""
        return self._trial.measured(self.rover.encoders)

    @property
    def wheel_speeds(self) -> tuple[float, float]:
        """Left and right, m/s, as the encoders see them."""
        return self._wheels(*self.measured)

    @property
    def _obeys(self) -> bool:
        return self.enabled and not self._braking

    def _real(self, limits: dict[str, float]) -> dict[str, float]:
        """Return the rover's real accelerations under the commanded ``limits``."""
        return {name: limit * self._trial.efforts[name] for name, limit in limits.items()}

    def _wheels(self, v: float, omega: float) -> tuple[float, float]:
        return v - omega * self._half_track, v + omega * self._half_track

    # Time.

    def substep(self, halted: bool) -> None:
        """Advance by 0.01 s. While ``halted``, the setpoints wait (watchdog)."""
        idle = halted or not self.enabled or self._resting_s > 0.0
        wanted = None if idle else (self._speed(), self._turn())
        if wanted != self._commanded:
            self._driven = (0.0, 0.0) if wanted is None else self._trial.driven(*wanted, self._driven)
            self.rover.command(*self._driven)
            self._commanded = wanted
        self.rover.substep()
        measured = self.measured
        self._count_way(measured)
        self._watch_stall(measured)
        if self._braking and not self.rover.moving:
            self._braking = False
            self.rover.change_limits(**self._real(self.limits))

    def _speed(self) -> float:
        speed = self._v
        if self._way_left is not None:
            speed = self._approach(self._way_left, DISTANCE_GAIN, self.limits["decel"])
            if abs(self._way_left) < DISTANCE_DONE_M and abs(self.rover.encoders.v) < STILL_M_S * 5:
                self._way_left = None
        return min(max(speed, -self.v_limit), self.v_limit)

    def _turn(self) -> float:
        omega = self._omega
        if self._heading is not None:
            left = wrap_angle(self._heading - self.odometry.theta)
            near = abs(left) < HEADING_DONE_RAD
            omega = 0.0 if near else self._approach(left, HEADING_GAIN, self.limits["alpha_decel"])
        return min(max(omega, -self.omega_limit), self.omega_limit)

    @staticmethod
    def _approach(left: float, gain: float, decel: float) -> float:
        """Return the speed at which to cover what is left, so that braking is in time."""
        braking = math.sqrt(2 * BRAKING_SHARE * decel * abs(left))
        return math.copysign(min(gain * abs(left), braking), left)

    def _count_way(self, measured: Velocity) -> None:
        v, omega = measured
        x, y, theta = self.odometry
        step = v * SUBSTEP_S
        # As the simulator moves: with the heading before the turn.
        self.odometry = Pose(
            x + step * math.cos(theta), y + step * math.sin(theta), wrap_angle(theta + omega * SUBSTEP_S)
        )
        left, right = self._wheels(v, omega)
        self.wheels_m = (self.wheels_m[0] + left * SUBSTEP_S, self.wheels_m[1] + right * SUBSTEP_S)
        if self._way_left is not None:
            self._way_left -= step

    def _watch_stall(self, measured: Velocity) -> None:
        self._resting_s = max(0.0, self._resting_s - SUBSTEP_S)
        if self._resting_s > 0.0:
            return
        asked, real = self._wheels(*self.rover.target), self._wheels(*measured)
        stuck = [
            abs(want) >= STALL_WHEEL_M_S and have * want < STALL_SHARE * want * want
            for want, have in zip(asked, real, strict=True)
        ]
        if not any(stuck) or not self.rover.in_contact:
            self._pushing_s = 0.0
            if not any(stuck):
                self.stalled = (False, False)
            return
        self._pushing_s += SUBSTEP_S
        if self._pushing_s >= STALL_AFTER_S:
            self.stalled = (stuck[0], stuck[1])
            self._pushing_s, self._resting_s = 0.0, STALL_REST_S
