"""The simulated rover: its model, its rules of motion, and the base class of a body that obeys them.

1. A substep is 0.01 s. A command given before substep n is obeyed from substep n + delay on.
2. The rover has no speed of its own beside its body's: before each step the body's velocity is changed, along
   the rover by at most a·dt toward the commanded one, across it by at most μ·g·dt toward zero (wheels do not
   roll sideways), and its rotation by at most α·dt. The effect of a collision on the body is thereby kept,
   and a rover can push no harder than its wheels accelerate it. A speed that is being turned is not lost: the
   wheels' sideways force does no work (without that, a substep of turning would cost v·(ω·dt)²/2 of speed,
   which adds up to more than 0.1 mm over a manoeuvre).
3. A skid-steered rover turns ``turn_gain`` times as much as its wheels say, and about a centre that lies
   ``rotation_center_m`` behind its middle, because its weight does. Limits and commands of the turn rate are
   those of the wheels; the sideways speed tends to ``rotation_center_m`` · ω in place of zero.
4. The position moves with the new velocity and the old heading, then the heading: the paper's kinematics.

``pymunk_rover.py`` implements them for one rover, ``fleet.py`` for many, with the same bits.
"""

import math
from abc import ABC, abstractmethod
from collections import deque

from pydantic import Field

from rover_ncp.core.config import StrictModel
from rover_ncp.core.geometry import Pose, Velocity

SUBSTEP_S = 0.01
"""Physics step in seconds, as in the paper's simulator."""
SUBSTEPS = 10
"""Physics steps in a control tick."""
GRAVITY_M_S2 = 9.81
STILL_M_S, STILL_RAD_S = 1e-3, 1e-3
"""Below both speeds a rover stands."""


class RoverModel(StrictModel):
    """A robot in the simulator; `sim.world.described` makes it from a robot description.

    Speeds in m/s and rad/s, accelerations in m/s² and rad/s²; ``decel`` and ``alpha_decel`` apply while the
    speed shrinks. Delays are whole substeps. Lengths in m, mass in kg.
    """

    accel: float = Field(gt=0)
    decel: float = Field(gt=0)
    alpha: float = Field(gt=0)
    alpha_decel: float = Field(gt=0)
    v_max: float = Field(gt=0)
    omega_max: float = Field(gt=0)
    delay_v_s: float = Field(ge=0, le=2)
    delay_omega_s: float = Field(ge=0, le=2)
    length: float = Field(gt=0)
    width: float = Field(gt=0)
    mass: float = Field(gt=0)
    turn_gain: float = Field(default=1.0, gt=0, description="turn of the rover over that of its wheels")
    rotation_center_m: float = Field(default=0.0, description="sideways speed over turn rate")
    friction: float = Field(default=0.6, ge=0, description="μ of the wheels across the rover")
    shell_friction: float = Field(default=0.3, ge=0, description="of its sides against an obstacle")
    half_track_m: float = Field(
        default=0.2, gt=0, description="half the difference of wheel speeds over turn rate"
    )
    dead_band_v: float = Field(default=0.0, ge=0, description="least speed command that is followed")
    dead_band_omega: float = Field(default=0.0, ge=0, description="least turn command that is followed")
    stiction: float = Field(
        default=0.0, ge=0, le=1, description="share by which the dead bands of a moving rover are narrower"
    )
    wheel_min: float = Field(default=0.0, ge=0, description="least speed of a turning wheel")
    slow_wheels_turn: bool = Field(
        default=False, description="whether a slower wheel turns at wheel_min, and does not stand"
    )

    @property
    def delay_v_substeps(self) -> int:
        """Substeps that still run with the old forward speed."""
        return round(self.delay_v_s / SUBSTEP_S)

    @property
    def delay_omega_substeps(self) -> int:
        """Substeps that still run with the old rate of turn."""
        return round(self.delay_omega_s / SUBSTEP_S)


class CommandQueue:
    """The commands of one rover, each obeyed after the model's delays; ``limits`` are those in force."""

    def __init__(self, model: RoverModel) -> None:
        self._model, self._substep = model, 0
        self.limits = model
        # (first substep that obeys it, value)
        self._v: deque[tuple[int, float]] = deque()
        self._omega: deque[tuple[int, float]] = deque()
        self.clear()

    def put(self, v: float, omega: float) -> None:
        """Take a command (m/s, rad/s). Raises ValueError when it is not finite."""
        if not (math.isfinite(v) and math.isfinite(omega)):
            raise ValueError(f"a command must be finite, got v={v}, omega={omega}")
        self._v.append((self._substep + self._model.delay_v_substeps, v))
        self._omega.append((self._substep + self._model.delay_omega_substeps, omega))

    def clear(self) -> None:
        """Forget all commands: the target is zero."""
        self._v.clear()
        self._omega.clear()
        self._v_target = self._omega_target = 0.0

    def change_limits(self, **limits: float) -> None:
        """Replace some limits of speeds and accelerations, by name."""
        self.limits = self.limits.model_copy(update=limits)

    def begin_substep(self) -> Velocity:
        """Return the target of the substep that begins."""
        while self._v and self._v[0][0] <= self._substep:
            self._v_target = self._v.popleft()[1]
        while self._omega and self._omega[0][0] <= self._substep:
            self._omega_target = self._omega.popleft()[1]
        self._substep += 1
        return self.target

    @property
    def target(self) -> Velocity:
        """The delayed command within the speed limits."""
        v_max, omega_max = self.limits.v_max, self.limits.omega_max
        return Velocity(
            min(max(self._v_target, -v_max), v_max), min(max(self._omega_target, -omega_max), omega_max)
        )


class Rover(ABC):
    """The simulated body of one rover among obstacles; poses in their frame, the course's."""

    def __init__(self, model: RoverModel) -> None:
        self.model, self.commands = model, CommandQueue(model)

    def command(self, v: float, omega: float) -> None:
        """Ask for a forward speed (m/s) and a rate of turn (rad/s), obeyed after the model's delays.

        Raises ValueError for one that is not finite.
        """
        self.commands.put(v, omega)

    def change_limits(self, **limits: float) -> None:
        """Replace some limits of speeds and accelerations, by name."""
        self.commands.change_limits(**limits)

    @property
    def target(self) -> Velocity:
        """The velocity that the rover accelerates toward: the delayed command within the speed limits."""
        return self.commands.target

    @abstractmethod
    def set_pose(self, pose: Pose) -> None:
        """Put the rover somewhere, standing still, all commands forgotten."""

    @abstractmethod
    def push(self, shift: Pose) -> None:
        """Shift the rover at once; it keeps its velocity."""

    @abstractmethod
    def substep(self) -> None:
        """Advance by 0.01 s."""

    @abstractmethod
    def range_along(self, ray: Pose, most_m: float) -> float | None:
        """Return the distance in m from a ray's origin to the first obstacle; None beyond ``most_m``."""

    @property
    @abstractmethod
    def pose(self) -> Pose:
        """The true pose of the base."""

    @property
    @abstractmethod
    def turned(self) -> float:
        """The heading in rad, whole turns included."""

    @property
    @abstractmethod
    def velocity(self) -> Velocity:
        """The body's true motion along the rover and its rotation; a stalled rover's is zero."""

    @property
    @abstractmethod
    def encoders(self) -> Velocity:
        """The motion that the encoders measure: the wheels' mean speed, and the turn by the nominal track."""

    @property
    def moving(self) -> bool:
        """Whether the encoders measure motion, beyond ``STILL_M_S`` or ``STILL_RAD_S``."""
        v, omega = self.encoders
        return abs(v) > STILL_M_S or abs(omega) > STILL_RAD_S

    @property
    @abstractmethod
    def in_contact(self) -> bool:
        """Whether the last substep found the rover touching something."""


# Repeated in `rover_ncp/native/fleet.cpp`, with the same bits.


def toward(speed: float, target: float, rise: float, fall: float) -> float:
    """Return ``speed`` moved toward ``target`` by at most ``rise``, or ``fall`` while its size shrinks.

    >>> toward(0.10, 0.16, 0.0031, 0.0062)
    0.1031
    """
    step = rise if speed * (target - speed) >= 0.0 else fall
    return min(max(target, speed - step), speed + step)


def own_axes(cos: float, sin: float, vx: float, vy: float, omega: float) -> tuple[float, float]:
    """Return the speeds along the rover and across it, from its heading, velocity and rate of turn.

    The velocity still points where the rover headed before the last substep turned it by ω·dt; the speed
    along the rover is what it was along that old heading (cosine and sine of ω·dt by their series).
    """
    forward = cos * vx + sin * vy
    sideways = cos * vy - sin * vx
    turn = omega * SUBSTEP_S
    square = turn * turn
    return forward * (1.0 - 0.5 * square) - sideways * (turn * (1.0 - square / 6.0)), sideways
