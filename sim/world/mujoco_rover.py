"""A skid-steered rover on MuJoCo: a rigid body in an independent simulator, to judge what pymunk trained.

Four wheels, coupled on each side, on level or sloped ground. A motor controller on each side follows the
wheel speed that the base asks for, within its torque. Encoders count whole ticks. How the rover turns and
slides follows from friction and weight. Wheels are spheres on soft tyres, because cylinders and stiff
contacts hop, and the rover then turns 5 to 40 % less. A slope is a tilted gravity, so poses stay on the
course's plane.
"""

import math
from collections import deque
from collections.abc import Sequence

import mujoco
import numpy as np

from rover_ncp.core.geometry import ORIGIN, STANDSTILL, Pose, Velocity
from rover_ncp.course.course import Obstacle
from sim.world.rover import (
    GRAVITY_M_S2,
    STILL_M_S,
    STILL_RAD_S,
    SUBSTEP_S,
    Rover,
    RoverModel,
    toward,
)
from sim.world.skid_robot import SkidRobot

CONTROL_S = 0.005
"""Period of the motor controllers."""
TICKS_PER_M = 128_000
"""Encoder ticks per metre at the nominal wheel radius (TicksMM as users of P3-AT set it)."""
MOVING_S = 0.05
"""Encoder speeds are means over this time where motion is judged: one tick in a substep is 0.8 mm/s."""
PROPORTIONAL, INTEGRAL = 60.0, 1500.0
"""Gains of a motor controller, in N·m per m/s and per m at the rims (chosen): a step takes 20 ms, and a
rim that is held gives way by 1 mm for 1.5 N·m."""
WALL_HEIGHT_M = 0.5
CABLE_M = 3.0
SETTLING_S = 0.5
"""Time for a rover to settle on its tyres before it is placed."""
RAY_BELOW_M = 0.027
"""Distance of the rays to walls below the robot's top."""
WHEEL_INERTIA, ARMATURE = (0.003, 0.006, 0.003), 0.005
"""Inertias of a wheel and of its motor for a 3-AT; others have them by mass and radius squared."""
_WALLS_ONLY = np.array([0, 1, 0, 0, 0, 0], np.uint8)
"""The geometry groups that a ray meets."""
_YAW = 2
"""Index of the gyro's vertical axis among the sensors' values."""
USUAL = SkidRobot()
WHEELS = "front_left", "front_right", "rear_left", "rear_right"
_CABLES, _WALLS = 1, 2
"""Bits of collisions: tyres roll over cables, walls stop tyres and shell."""
_TYRES = _CABLES | _WALLS


TYRE_IMPEDANCE, SLIP_S = 0.5, 0.1
"""MuJoCo's solimp of a tyre, and the time constant of its friction. A soft tyre and a slow friction keep the
lift small that MuJoCo's friction cone gives a sliding contact, about μ·slip·tyre_s²/SLIP_S."""
FULL_FRICTION = 100.0
"""MuJoCo's impratio: with SLIP_S it sets the slip from which friction is full: about 0.8 mm/s at μ = 0.7,
by the creep on a slope."""


def _model_xml(robot: SkidRobot, model: RoverModel, obstacles: Sequence[Obstacle]) -> str:
    """Return the MJCF of a rover at the origin."""
    radius, wheel_kg, contact = robot.wheel_radius_m, robot.wheel_mass_kg, robot.contact
    frame_kg = robot.mass_kg - 4 * wheel_kg
    # The wheels' own centre of mass is the middle.
    ahead, left = (place * robot.mass_kg / frame_kg for place in robot.mass_center_m)
    length, width, height = model.length, model.width, robot.height_m
    inertia = " ".join(
        str(frame_kg / 12 * (a * a + b * b)) for a, b in ((width, height), (length, height), (length, width))
    )
    base, track = robot.half_wheelbase_m, robot.half_track_m
    places = ((base, track), (base, -track), (-base, track), (-base, -track))
    corners = [(name, x, y) for name, (x, y) in zip(WHEELS, places, strict=True)]
    tyre = f'solref="{contact.tyre_s} 1" solimp="{TYRE_IMPEDANCE} {TYRE_IMPEDANCE} 0.001"'
    heavy = wheel_kg * radius * radius / (USUAL.wheel_mass_kg * USUAL.wheel_radius_m * USUAL.wheel_radius_m)
    wheel_inertia = " ".join(str(heavy * each) for each in WHEEL_INERTIA)
    wheels = "".join(
        f"""
      <body pos="{x} {y} {radius}">
        <inertial pos="0 0 0" mass="{wheel_kg}" diaginertia="{wheel_inertia}"/>
        <joint name="{name}" type="hinge" axis="0 1 0" armature="{heavy * ARMATURE}"/>
        <geom name="{name}" type="sphere" size="{radius * factor}" contype="0" conaffinity="{_TYRES}"
          friction="{robot.friction} 0 0" {tyre}/>
      </body>"""
        for (name, x, y), factor in zip(corners, robot.radius_factors, strict=True)
    )
    pairs = "".join(
        f"""
    <pair name="{name}" geom1="ground" geom2="{name}" condim="3" friction="{robot.friction} {robot.friction}"
      solreffriction="{SLIP_S} 1" {tyre}/>"""
        for name, _, _ in corners
    )
    walls = "".join(
        f"""
    <geom type="box" size="{wall.length / 2} {wall.width / 2} {WALL_HEIGHT_M / 2}" contype="{_WALLS}"
      conaffinity="0" pos="{wall.x} {wall.y} {WALL_HEIGHT_M / 2}" euler="0 0 {wall.theta}" group="1"/>"""
        for wall in obstacles
    )
    cables = "".join(
        f"""
    <geom type="capsule" size="{robot.cable_height_m / 2} {CABLE_M / 2}" contype="{_CABLES}" conaffinity="0"
      pos="{x} {y} {robot.cable_height_m / 2}" zaxis="{math.cos(theta)} {math.sin(theta)} 0" {tyre}/>"""
        for x, y, theta in robot.cables
    )
    down = GRAVITY_M_S2 * math.sin(robot.slope_rad)
    gravity = (
        -down * math.cos(robot.uphill_rad),
        -down * math.sin(robot.uphill_rad),
        -GRAVITY_M_S2 * math.cos(robot.slope_rad),
    )
    half_height = 0.5 * (height - robot.clearance_m)
    return f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{contact.step_s}" integrator="implicitfast" cone="elliptic"
    impratio="{FULL_FRICTION * contact.stickiness}" gravity="{gravity[0]} {gravity[1]} {gravity[2]}"/>
  <worldbody>
    <geom name="ground" type="plane" size="0 0 1" contype="0" conaffinity="0"/>{walls}{cables}
    <body>
      <freejoint/>
      <inertial pos="{ahead} {left} {robot.mass_height_m}" mass="{frame_kg}" diaginertia="{inertia}"/>
      <geom type="box" size="{length / 2} {width / 2} {half_height}" contype="0" conaffinity="{_WALLS}"
        pos="0 0 {robot.clearance_m + half_height}" friction="{model.shell_friction} 0 0"/>
      <site name="imu"/>{wheels}
    </body>
  </worldbody>
  <contact>{pairs}
  </contact>
  <equality>
    <joint joint1="front_left" joint2="rear_left"/>
    <joint joint1="front_right" joint2="rear_right"/>
  </equality>
  <tendon>
    <fixed name="left"><joint joint="front_left" coef="0.5"/><joint joint="rear_left" coef="0.5"/></fixed>
    <fixed name="right"><joint joint="front_right" coef="0.5"/><joint joint="rear_right" coef="0.5"/></fixed>
  </tendon>
  <actuator>
    <motor tendon="left" ctrllimited="true" ctrlrange="-{robot.torque_n_m} {robot.torque_n_m}"/>
    <motor tendon="right" ctrllimited="true" ctrlrange="-{robot.torque_n_m} {robot.torque_n_m}"/>
  </actuator>
  <sensor>
    <gyro site="imu"/>
    <accelerometer name="accelerometer" site="imu"/>
  </sensor>
</mujoco>"""


class MujocoRover(Rover):
    """A rover alone on its ground."""

    def __init__(
        self,
        model: RoverModel,
        robot: SkidRobot,
        obstacles: Sequence[Obstacle] = (),
        pose: Pose = ORIGIN,
    ) -> None:
        super().__init__(model)
        self.robot = robot
        self._physics = mujoco.MjModel.from_xml_string(_model_xml(robot, model, obstacles))
        self.data = mujoco.MjData(self._physics)
        self._steps = round(CONTROL_S / robot.contact.step_s)
        self._tyres = [(self._physics.pair(name).id, self._physics.geom(name).id) for name in WHEELS]
        self._walls = set(np.flatnonzero(self._physics.geom_contype == _WALLS).tolist())
        self.set_pose(pose)

    def set_pose(self, pose: Pose) -> None:
        mujoco.mj_resetData(self._physics, self.data)
        self.commands.clear()
        self._asked = STANDSTILL
        """The motion that the motor controllers follow now."""
        self._left, self._right = Motor(self.robot), Motor(self.robot)
        self._recent = deque([STANDSTILL], maxlen=round(MOVING_S / SUBSTEP_S))
        """The encoders' motion in the last substeps."""
        self._turned = 0.0
        self._place(pose)
        # The tyres take the weight, and the motors hold the rover on its slope, before it is there.
        for _ in range(round(SETTLING_S / CONTROL_S)):
            self._control(0.0, 0.0)
        self._place(pose)
        self._turned = pose.theta

    def push(self, shift: Pose) -> None:
        x, y, theta = self.pose
        self._place(Pose(x + shift.x, y + shift.y, theta + shift.theta))
        self._turned += shift.theta

    def _place(self, pose: Pose) -> None:
        half = 0.5 * pose.theta
        qpos = self.data.qpos
        qpos[:2] = pose.x, pose.y
        qpos[3:7] = math.cos(half), 0.0, 0.0, math.sin(half)

    def substep(self) -> None:
        limits, target = self.commands.limits, self.commands.begin_substep()
        v = toward(self._asked.v, target.v, limits.accel * SUBSTEP_S, limits.decel * SUBSTEP_S)
        omega = toward(
            self._asked.omega, target.omega, limits.alpha * SUBSTEP_S, limits.alpha_decel * SUBSTEP_S
        )
        self._asked = Velocity(v, omega)
        half = self.robot.nominal_half_track_m
        left, right = self._left.way_m, self._right.way_m
        for _ in range(round(SUBSTEP_S / CONTROL_S)):
            self._control(v - omega * half, v + omega * half)
        left, right = (self._left.way_m - left) / SUBSTEP_S, (self._right.way_m - right) / SUBSTEP_S
        self._recent.append(Velocity(0.5 * (left + right), 0.5 * (right - left) / half))

    def _control(self, left: float, right: float) -> None:
        """Advance by a control period, toward speeds of the rims in m/s."""
        data = self.data
        data.ctrl[:] = self._left.torque(left), self._right.torque(right)
        self._step()
        for side, motor in enumerate((self._left, self._right)):
            motor.measure(float(data.ten_length[side]), float(data.ten_velocity[side]))
        self._turned += float(data.sensordata[_YAW]) * CONTROL_S

    def _step(self) -> None:
        """Advance the physics by a control period; each tyre has the friction of the floor below it."""
        if self.robot.patches is not None:
            for pair, geom in self._tyres:
                x, y, _ = self.data.geom_xpos[geom].tolist()
                patch = self.robot.patches.under(x, y)
                friction = self.robot.patches.friction if patch else self.robot.friction
                self._physics.pair_friction[pair, :2] = friction
        mujoco.mj_step(self._physics, self.data, nstep=self._steps)

    def range_along(self, ray: Pose, most_m: float) -> float | None:
        start, hit = np.array([ray.x, ray.y, self.robot.height_m - RAY_BELOW_M]), np.zeros(1, np.int32)
        along = np.array([math.cos(ray.theta), math.sin(ray.theta), 0.0])
        way = mujoco.mj_ray(self._physics, self.data, start, along, _WALLS_ONLY, 1, -1, hit)
        return float(way) if 0.0 <= way <= most_m else None

    @property
    def pose(self) -> Pose:
        x, y, _, w, i, j, k = self.data.qpos[:7].tolist()
        return Pose(x, y, math.atan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k)))

    @property
    def turned(self) -> float:
        return self._turned

    @property
    def velocity(self) -> Velocity:
        theta = self.pose.theta
        vx, vy, _, _, _, omega = self.data.qvel[:6].tolist()
        return Velocity(math.cos(theta) * vx + math.sin(theta) * vy, omega)

    @property
    def encoders(self) -> Velocity:
        return self._recent[-1]

    @property
    def moving(self) -> bool:
        v = sum(motion.v for motion in self._recent) / len(self._recent)
        omega = sum(motion.omega for motion in self._recent) / len(self._recent)
        return abs(v) > STILL_M_S or abs(omega) > STILL_RAD_S

    @property
    def in_contact(self) -> bool:
        return not self._walls.isdisjoint(self.data.contact.geom.ravel().tolist())


class Motor:
    """The controller and the encoder of one side, or of one wheel."""

    def __init__(self, robot: SkidRobot) -> None:
        self._robot = robot
        self._most_n_m = robot.torque_n_m
        self._stronger = robot.torque_n_m / USUAL.torque_n_m
        self._ticks, self._speed, self._integral = 0, 0.0, 0.0
        self._rests = True

    @property
    def way_m(self) -> float:
        """Way of the rim by the encoder, at the nominal radius."""
        return self._ticks / TICKS_PER_M

    def torque(self, wanted: float) -> float:
        """Return the torque in N·m for the next period, so that the rim goes at ``wanted`` m/s.

        A rim that comes to rest gives up the torque that the last turn needed, and then holds its place.
        """
        rested, self._rests = self._rests, wanted == 0.0 and (self._rests or abs(self._speed) < STILL_M_S)
        if self._rests and not rested:
            self._integral = 0.0
        error, most = wanted - self._speed, self._most_n_m
        self._integral = min(max(self._integral + self._stronger * INTEGRAL * CONTROL_S * error, -most), most)
        return min(max(self._stronger * PROPORTIONAL * error + self._integral, -most), most)

    def measure(self, angle: float, rate: float) -> None:
        """Read the shaft at a period's end: rad in all, and rad/s, for which ticks are too coarse."""
        self._ticks = math.floor(angle * self._robot.wheel_radius_m * TICKS_PER_M)
        self._speed = rate * self._robot.wheel_radius_m
