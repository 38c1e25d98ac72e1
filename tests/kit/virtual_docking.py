"""A drive to a place on the virtual clock, among obstacles, with a localiser that may lose the rover."""

import numpy as np

from deploy.drive.config import place_config
from deploy.place.docking import Docking
from deploy.place.place import Place
from deploy.place.plan import approach
from kit.virtual_drive import VirtualDrive
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.geometry import Pose
from rover_ncp.wire.messages import battery_state, pose_with_covariance, read_battery
from sim.stack.lines import WALL_NS
from sim.world.pymunk_rover import Ground

POSE_S = 0.125
COVARIANCE = np.diag(np.square([0.002, 0.002, 0.004]))


def place(**changed):
    """Return a place of which the axis is that of the frame; ``changed`` are keys of its file."""
    return Place(**{"name": "bay", "frame": "map", "pose": {"x": 2.0, "y": 1.0, "theta": 0.0}} | changed)


BEFORE_STAGING = Pose(1.05, 1.12, -0.5)
STAGING = place().staging


class VirtualDocking(VirtualDrive):
    """One drive from ``start`` to a place. ``see`` returns the pose that the localiser sends, or None."""

    def __init__(self, where, start, *, path=None, obstacles=(), see=lambda pose, now: pose, **settings):
        self.place, self.path, self.course = where, path, approach(where).course
        self.start = start
        self.policy, self.staging = load_policy("dock"), load_policy("course")
        self.config = place_config(where, None, None, robot="virtual", policy="dock", **settings)
        self._see, self._next_s = see, 0.0
        self._place(Ground(obstacles), start)
        self.link._start = None
        self.base.observe = self._localise

    def mission(self):
        return Docking(self.config, self.staging, self.policy)

    def _localise(self, now):
        if now < self._next_s:
            return
        self._next_s += POSE_S
        if (seen := self._see(self.rover.pose, now)) is not None:
            frame = self.place.frame
            data = pose_with_covariance(Pose(*seen), COVARIANCE, WALL_NS + round(now * NS_PER_S), frame)
            self.link.localise(data, round(now * NS_PER_S))

    @property
    def off(self):
        """The true pose minus the place: ahead and left in m, turned in rad."""
        found = self.place.errors(self.rover.pose)
        return found.longitudinal_m, found.lateral_m, found.yaw_rad


def charging(drive, value):
    """Have the base report that its battery charges or does not."""
    drive.link.change["battery_state"] = lambda data: battery_state(
        12.5, read_battery(data).stamp_ns, charging=value
    )
    return drive
