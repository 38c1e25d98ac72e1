"""Opens the base that an address and a model name: a Pioneer, a ROS 2 robot over Zenoh, or another base.

Other bases are classes of other packages, with the methods of `bridge.base.Base`. A package registers its own
in pyproject.toml:

    [project.entry-points."rover_ncp.bases"]
    json = "json_base:JsonBase"

``bridge --base json/REST --model FILE`` calls it with REST, the robot's description and a function that puts
arrivals into the bridge's inbox, from any thread. They come to ``receive`` in the bridge's loop, in order.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from bridge.base import Base
from bridge.gate.limits import Limits
from bridge.inbox import Inbox
from bridge.pioneer.base import ArcosBase
from bridge.pioneer.connection import BaseConnection
from bridge.pioneer.odometry import ROBOTS
from bridge.pioneer.session import Session
from bridge.pioneer.setpoints import MotionLimits
from bridge.ros2.address import RosAddress, parse_ros_address
from bridge.ros2.base import Ros2Base
from bridge.ros2.connection import LOOP_KEY, RosConnection
from bridge.ros2.discovery import LoopSeen
from bridge.zenoh.link import ZenohLink
from rover_ncp.core.config import load_yaml
from rover_ncp.core.errors import ConfigError, NoRobot, RoverNcpError, UsageError
from rover_ncp.core.files import shipped_names
from rover_ncp.robot.description import RobotDescription, load_description
from rover_ncp.wire.address import ROS2

BASES = "rover_ncp.bases"


OpenBase = Callable[[str, RobotDescription, Callable[[object], None]], Base]
"""Opens a base of another package. Arrivals may be put from any thread; only `Base.receive` looks at them."""


@dataclass(frozen=True)
class ChosenBase:
    """``description`` is None for a Pioneer that says itself what it is; ``ros2`` is None for others.

    ``entry_point`` is that of a base of another package, if one is named.
    """

    address: str
    description: RobotDescription | None
    ros2: RosAddress | None = None
    entry_point: EntryPoint | None = None


def choose_base(
    address: str, model: str, zenoh_config: Path | None = None, measured_base_timeout_s: float | None = None
) -> ChosenBase:
    """Check an address and a model; ``zenoh_config`` is for the session with a ROS 2 robot.

    A measured timeout of this very robot replaces that of its description.

    Raises UsageError, FileError or ConfigError.
    """
    ros2 = parse_ros_address(address, zenoh_config) if address.startswith(ROS2) else None
    if zenoh_config is not None and ros2 is None:
        raise UsageError(f"--base-zenoh-config: {address} is not a ROS 2 robot (ros2/tcp/HOST)")
    other = next(iter(entry_points(group=BASES, name=address.partition("/")[0])), None)
    if model == "auto":
        if ros2 is None and other is None:
            return ChosenBase(address, None)
        known = ", ".join(shipped_names("robots"))
        raise UsageError(f"--model auto: only a Pioneer says what it is; name a file, or {known}")
    description = load_description(model)
    if measured_base_timeout_s is not None:
        update = {"measured_base_timeout_s": measured_base_timeout_s}
        description = description.model_copy(update=update)
    if other is not None:
        return ChosenBase(address, description, entry_point=other)
    if ros2 is None:
        if description.arcos is None:
            raise UsageError(
                f"--model {model}: it has no arcos, which a Pioneer has; expected auto, {', '.join(ROBOTS)}"
            )
        return ChosenBase(address, description)
    if description.topics is None:
        raise UsageError(f"--model {model}: the description has no topics, which a ROS 2 robot needs")
    return ChosenBase(address, description, ros2)


def gate_limits(
    file: Path | None, description: RobotDescription | None, given: Limits | None = None
) -> Limits:
    """Return the gate's limits, from a file or the defaults; a robot bounds them by its own.

    With ``given`` these are the file's limits, read before.

    The bridge sets a Pioneer's deceleration, so `brake` is at most that. Without a description the limits are
    bounded when the Pioneer says what it is.

    Raises FileError or ConfigError, and UsageError for a limit in the file that is wider than the robot's.
    """
    if given is None:
        given = Limits() if file is None else load_yaml(file, Limits)
    # A user who writes the key wants the rover to stop there.
    empty = [
        name
        for name in ("fence", "sonar_stop_m")
        if name in given.model_fields_set and getattr(given, name) is None
    ]
    if empty:
        raise ConfigError(
            str(file), [f"{name}: no value; leave the key out for no such stop" for name in empty]
        )
    if (description is None or description.arcos is not None) and given.brake > MotionLimits.decel:
        raise UsageError(
            f"{file}: brake is {given.brake:g}; "
            f"expected at most {MotionLimits.decel:g}, the deceleration that the bridge sets in a Pioneer"
        )
    if description is None:
        return given
    motion = description.motion
    own = {
        "v_max": motion.v_max,
        "omega_max": motion.omega_max,
        "brake": motion.decel,
        "speed_mean_s": description.odometry.speed_mean_s,
    }
    for name, most in own.items():
        value = getattr(given, name)
        if name in given.model_fields_set and value > most:
            raise UsageError(f"{file}: {name} is {value:g}, but {description.name} has {most:g} at most")
    min_v = description.battery.min_v
    if "battery_min_v" in given.model_fields_set and given.battery_min_v < min_v:
        raise UsageError(
            f"{file}: battery_min_v is {given.battery_min_v:g}, but {description.name} has {min_v:g} at least"
        )
    return given.within(description)


def open_base(
    chosen: ChosenBase,
    limits: Limits,
    inbox: Inbox,
    link: ZenohLink,
    *,
    no_base_watchdog: bool,
) -> tuple[Base, str]:
    """Open the line to the base; also return what a user has to know of it.

    Raises UsageError, FileError, ConfigError and NoRobot.
    """
    if chosen.entry_point is not None:
        assert chosen.description is not None  # choose_base checks it
        try:
            opens: OpenBase = chosen.entry_point.load()
        except Exception as error:
            found = chosen.entry_point
            raise UsageError(f"base {found.name} ({found.value}) cannot be loaded: {error}") from error
        try:
            base = opens(chosen.address.partition("/")[2], chosen.description, inbox.put)
        except RoverNcpError:
            raise
        except Exception as error:
            raise NoRobot(f"{chosen.address}: the base failed: {error}") from error
        return base, ""
    if chosen.ros2 is None:
        session = Session(chosen.description, MotionLimits(v=limits.v_max, omega=limits.omega_max))
        return ArcosBase(BaseConnection(chosen.address, inbox), session), ""
    ros2, line = open_ros2_base(chosen, inbox, unsafe=no_base_watchdog)
    link.watch_robot_side(f"{LOOP_KEY}/{line.nonce}", lambda there: inbox.put(LoopSeen(there)))
    return ros2, ros2.note


def open_ros2_base(chosen: ChosenBase, inbox: Inbox, *, unsafe: bool) -> tuple[Ros2Base, RosConnection]:
    """Open the session with a ROS 2 robot. Raises FileError, ConfigError, UsageError or NoRobot."""
    assert chosen.ros2 is not None  # choose_base checks both
    assert chosen.description is not None and chosen.description.topics is not None
    line = RosConnection(chosen.ros2, chosen.description.topics, inbox)
    return Ros2Base(line, chosen.description, unsafe=unsafe), line
