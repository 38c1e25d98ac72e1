"""Robots of `varied` with one more error, which the estimator does not model; `lasting.py` drives them.

- scale: the gyro reads 3 % more, every second one 3 % less
- ramp: the gyro's bias grows to 0.5 °/s within the first 20 s of motion, every second one's to −0.5 °/s
- kicks: at each start and reversal, casters push the rover 1 cm to a random side, which no encoder shows
- four: each wheel has its own motor; odometry reads the front ones
- heavy: on the slopes of `slope`, with twice a Pioneer's mass and height, softer tyres and a longer base
- husky: the masses of a Husky's URDF
"""

import math
from dataclasses import dataclass
from random import Random

import numpy as np

from rover_ncp.core.geometry import Pose
from sim.base.trial import Drawn
from sim.stack.trials import Stack
from sim.world.mujoco_rover import CONTROL_S, Motor, MujocoRover
from sim.world.rover import SUBSTEP_S
from sim.world.skid_robot import Contact

SCALE, DRIFT_RAD_S, RAMP_S, KICK_M = 0.03, math.radians(0.5), 20.0, 0.01
WHEELS = slice(6, 10)
"""Degrees of freedom: front left, front right, rear left, rear right."""
HEAVY = {
    "mass_kg": 24.0,
    "wheel_mass_kg": 1.5,
    "mass_height_m": 0.3,
    "half_wheelbase_m": 0.18,
    "contact": Contact(tyre_s=0.03),
}
HUSKY = {"mass_kg": 46.034 + 4 * 2.637, "wheel_mass_kg": 2.637, "mass_height_m": 0.062 + 0.1651 - 0.03282}
"""From husky.urdf.xacro and wheel.urdf.xacro of github.com/husky/husky at 03cff37. Its centre of mass is
above the base's bottom plate, which is above the ground by the wheels' radius less their offset."""
BODIES = {"heavy": HEAVY, "husky": HUSKY}


class Odd(MujocoRover):
    """A robot with one more error."""

    number = 0
    """The trial's; its parity is the sign of the error."""

    @property
    def sign(self) -> float:
        """1 or -1."""
        return 1.0 if self.number % 2 else -1.0


class Scale(Odd):
    """Its gyro reads more or less."""

    @property
    def turned(self) -> float:
        return super().turned * (1.0 + self.sign * SCALE)


class Ramp(Odd):
    """Its gyro's bias grows once it moves."""

    moved_s = read_rad = 0.0

    def substep(self) -> None:
        super().substep()
        if self.moved_s > 0.0 or self.moving:
            self.moved_s += SUBSTEP_S
        self.read_rad += self.sign * DRIFT_RAD_S * SUBSTEP_S * min(self.moved_s / RAMP_S, 1.0)

    @property
    def turned(self) -> float:
        return super().turned + self.read_rad


class Kicks(Odd):
    """Its casters kick at each start and reversal."""

    way, kicks = 0.0, 0

    def substep(self) -> None:
        super().substep()
        before, self.way = self.way, float(np.sign(self.target.v))
        if self.way not in {0.0, before}:
            self.kicks += 1
            aside = Random(f"{self.number} {self.kicks}").choice((-KICK_M, KICK_M))
            theta = self.pose.theta
            self.push(Pose(-aside * math.sin(theta), aside * math.cos(theta), 0.0))


class Four(Odd):
    """Each wheel has its motor; none is coupled to another."""

    def set_pose(self, pose: Pose) -> None:
        self.motors = [Motor(self.robot) for _ in range(4)]
        super().set_pose(pose)

    def _control(self, left: float, right: float) -> None:
        data, wanted = self.data, (left, right, left, right)
        data.eq_active[:] = 0
        # A motor has half the torque of a side's.
        data.qfrc_applied[WHEELS] = [
            0.5 * motor.torque(v) for motor, v in zip(self.motors, wanted, strict=True)
        ]
        self._step()
        angles, rates = data.qpos[7:11].tolist(), data.qvel[WHEELS].tolist()
        for motor, angle, rate in zip(self.motors, angles, rates, strict=True):
            motor.measure(angle, rate)
        self._left, self._right = self.motors[:2]
        self._turned += float(data.sensordata[2]) * CONTROL_S


KINDS = {"scale": Scale, "ramp": Ramp, "kicks": Kicks, "four": Four, "heavy": Odd, "husky": Odd}


@dataclass(frozen=True)
class OddStack(Stack):
    """Trials of one kind of odd robots."""

    kind: str = "scale"

    def drawn(self, number: int) -> Drawn:
        rover, trials = super().drawn(number)
        assert isinstance(rover, MujocoRover)
        robot, start = rover.robot, Pose(*trials.start[0].tolist())
        robot = robot.model_copy(update=BODIES.get(self.kind, {}))
        odd = KINDS[self.kind](rover.model, robot, self.course(number).obstacles, start)
        odd.number = number
        return Drawn(odd, trials)
