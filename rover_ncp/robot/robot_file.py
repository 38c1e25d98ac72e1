"""The file ``robot.yaml``: one robot with all that its commands need, found in the working folder.

Paths in the file count from its folder. An option of a command overrides the file.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from textwrap import wrap
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from rover_ncp.core.config import MAX_NAME, StrictModel, dump_yaml, read_filled, read_yaml, validated
from rover_ncp.core.errors import ConfigError, UsageError
from rover_ncp.core.files import resolve
from rover_ncp.robot.description import MAX_BASE_TIMEOUT_S
from rover_ncp.wire.address import ROS2, parse_address
from rover_ncp.wire.key_table import Role

NAMES = ("robot.yaml", "robot.yml")
SUFFIXES = (".yaml", ".yml")
PIONEERS_BRIDGE, ROS2_BRIDGE = "tcp/127.0.0.1:7447", "tcp/127.0.0.1:7449"
"""Where the bridge listens by default; a ROS 2 robot's own router may have the first port."""
_EVERYWHERE = {"0.0.0.0", "::"}
_ABOUT_ROS2 = ("base_zenoh_config", "measured_base_timeout_s", "no_base_watchdog")


class CameraSettings(StrictModel):
    """The camera that sees tags."""

    source: str = Field(
        min_length=1,
        description="0 or /dev/v4l/by-id/NAME ('tag cameras' lists them), http://..., or a ROS 2 topic "
        "(ros2/tcp/HOST#image=TOPIC)",
    )
    file: str | None = Field(
        default=None, description="calibration and mount, as 'tag calibrate' writes them; ROS has its own"
    )
    picture: str | None = Field(
        default=None, description="JPEG that gets the newest picture once a second, its tags outlined"
    )


class RobotSettings(StrictModel):
    """The robot that all commands use which have ``--robot``. Paths count from this file's folder."""

    format: Literal[1] = Field(default=1, description="version of this file's form")
    base: str | None = Field(
        default=None,
        description="the robot: tcp/HOST[:8101], serial//dev/ttyUSB0, or ros2/tcp/HOST[:7447], a ROS 2 "
        "robot's Zenoh router; left out where the bridge runs on another machine",
    )
    base_zenoh_config: str | None = Field(
        default=None, description="of a ROS 2 robot: Zenoh configuration with TLS or password of its router"
    )
    model: str | None = Field(
        default=None,
        description="the robot's description, a name or a file; without it a Pioneer says what it is",
    )
    measured_base_timeout_s: float | None = Field(
        default=None,
        ge=0.01,
        le=MAX_BASE_TIMEOUT_S,
        description="of this very ROS 2 robot: 'rover-ncp bridge --measure-timeout' prints the line",
    )
    no_base_watchdog: bool = Field(
        default=False,
        description="true lets a ROS 2 robot be driven that may drive on if the bridge dies",
    )
    bridge: str | None = Field(
        default=None,
        description="where the bridge listens and drivers connect: tcp/127.0.0.1:7447, or port 7449 for a "
        "ROS 2 robot; with keys tls/0.0.0.0:7447 on the robot, tls/ROBOT:7447 elsewhere",
    )
    namespace: str = Field(default="", description="prefix of every key: bot1 makes bot1/odom")
    keys: str | None = Field(
        default=None, description="folder with certificates, as 'rover-ncp keys --out FOLDER' writes it"
    )
    limits: str | dict[str, Any] | None = Field(
        default=None,
        description="limits of the gate: a file, or keys such as {v_max: 0.2, sonar_stop_m: 0.3}",
    )
    camera: CameraSettings | None = Field(default=None, description="camera of the localiser")
    tags: str | None = Field(
        default=None,
        description="printed board that the camera sees, such as board-17-a4, or a file of single tags",
    )
    places: str = Field(default="places", description="folder of the places that 'place set NAME' writes")
    page: int | None = Field(
        default=8080, ge=0, le=65535, description="port of the live page of 'up'; null for no page"
    )
    resume: bool = Field(
        default=False,
        description="true: after a lost line 'up' resumes an interrupted docking, with 5 s of notice",
    )

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        if self.base is not None and not self.base.startswith(ROS2):
            odd = [name for name in _ABOUT_ROS2 if getattr(self, name)]
            if odd:
                raise ValueError(f"{odd[0]} is for a ROS 2 robot (ros2/tcp/HOST), but base is {self.base}")
        if self.base is not None and self.base.startswith(ROS2) and self.model is None:
            raise ValueError("model is missing: only a Pioneer says what it is; expected a name or a file")
        if self.bridge is not None and parse_address(self.bridge, 0) is None:
            raise ValueError(f"bridge is {self.bridge}, expected PROTOCOL/HOST[:PORT]")
        if self.tags is not None and self.camera is None:
            raise ValueError("tags needs camera, which sees them")
        return self


@dataclass(frozen=True)
class RobotFile:
    """A robot's file that was read; its paths are resolved."""

    path: Path
    settings: RobotSettings

    @property
    def listen(self) -> str:
        """Where the bridge listens."""
        ros2 = (self.settings.base or "").startswith(ROS2)
        return self.settings.bridge or (ROS2_BRIDGE if ros2 else PIONEERS_BRIDGE)

    @property
    def address(self) -> str:
        """Where drivers of this machine reach the bridge."""
        found = parse_address(self.listen, 0)
        if found is None or found.host not in _EVERYWHERE:
            return self.listen
        return f"{found.protocol}/127.0.0.1{f':{found.port}' if found.port else ''}"

    @property
    def model(self) -> str | None:
        """The name or the path of the description. Raises ConfigError."""
        model = self.settings.model
        if model is None:
            return None
        try:
            return str(resolve("robots", model, self.path.parent)) if is_path(model) else model
        except UsageError as error:
            raise ConfigError(str(self.path), [f"$.model: {error}"]) from error

    @property
    def limits(self) -> Path | None:
        """The file of the gate's limits; None if it has none, or has them itself."""
        return self.place_of(self.settings.limits) if isinstance(self.settings.limits, str) else None

    @property
    def camera(self) -> str | None:
        """The camera's source."""
        if self.settings.camera is None:
            return None
        source = self.settings.camera.source
        folder = self.path.parent / source
        return str(folder) if folder.is_dir() else source

    @property
    def picture(self) -> Path | None:
        """The picture that the localiser writes."""
        camera = self.settings.camera
        return None if camera is None else self.place_of(camera.picture)

    @property
    def tags(self) -> Path | None:
        """The board's name, or the file of the tags."""
        tags = self.settings.tags
        return Path(tags) if tags is not None and not is_path(tags) else self.place_of(tags)

    def place_of(self, name: str | None) -> Path | None:
        """Return the path that a value of the file names."""
        return None if name is None else self.path.parent / name

    def zenoh_config(self, role: Role) -> Path | None:
        """Return a role's Zenoh configuration, None without keys."""
        folder = self.place_of(self.settings.keys)
        return None if folder is None else folder / f"{role.value}.json5"

    def need(self, key: str, why: str) -> Any:
        """Return a value of the file. Raises ConfigError if it has none."""
        value = getattr(self.settings, key)
        if value is None:
            raise ConfigError(str(self.path), [f"$.{key}: this key is missing: {why}"])
        return value


def is_path(name: str) -> bool:
    """Return whether a value names a file by its path, not a shipped one by its name."""
    return "/" in name or bool(Path(name).suffix)


def is_robot_file(robot: str) -> bool:
    """Return whether a value of ``--robot`` names a file; it is an address otherwise."""
    return robot.lower().endswith(SUFFIXES)


def find_robot_file(robot: str | None) -> RobotFile | None:
    """Read the file that ``--robot`` names, or the one in the working folder; None for an address.

    Raises UsageError if there is no such file or two, FileError and ConfigError.
    """
    if robot is not None:
        return load_robot_file(Path(robot)) if is_robot_file(robot) else None
    found = [name for name in NAMES if Path(name).exists()]
    if len(found) > 1:
        raise UsageError(f"{' and '.join(found)} are both in this folder: give one of them as --robot")
    return load_robot_file(Path(found[0])) if found else None


def require_robot_file(robot: str | None) -> RobotFile:
    """Read the file that ``--robot`` names, or the one in the working folder. Raises as `find_robot_file`."""
    file = find_robot_file(robot)
    if file is None:
        raise missing("a file") if robot is None else UsageError(f"--robot {robot}: expected a file, .yaml")
    return file


def missing(expected: str) -> UsageError:
    """Return the error of a command that knows no robot; ``expected`` is what ``--robot`` may be."""
    return UsageError(
        f"no robot: {NAMES[0]} is not in this folder; give --robot ({expected}), or write the file with "
        "'rover-ncp setup'"
    )


def load_robot_file(path: Path) -> RobotFile:
    """Read a robot's file. Raises FileError or ConfigError."""
    source = str(path)
    data = read_yaml(read_filled(path), source)
    if not isinstance(data, dict):
        raise ConfigError(source, [f"expected a mapping of keys, got {type(data).__name__}"])
    known = list(RobotSettings.model_fields)
    if {"footprint", "based_on", "wheels"} & set(data):
        problem = "this is the description of a model of robot: name it as 'model: FILE' in a file of a robot"
        raise ConfigError(source, [problem])
    if unknown := [name for name in data if name not in known]:
        raise ConfigError(source, [_about_unknown(name, known) for name in unknown])
    return RobotFile(path, validated(data, RobotSettings, source))


def _about_unknown(name: str, known: list[str]) -> str:
    near = get_close_matches(name, known, 1)
    return f"$.{name[:MAX_NAME]}: unknown key; expected {near[0] if near else ', '.join(known)}"


_EXAMPLES = {
    "base": "tcp/127.0.0.1:8101",
    "base_zenoh_config": "router.json5",
    "model": "turtlebot4",
    "measured_base_timeout_s": 0.5,
    "bridge": PIONEERS_BRIDGE,
    "keys": "keys",
    "limits": {"v_max": 0.2},
    "camera": {"source": "0", "file": "camera.yaml"},
    "tags": "board-17-a4",
}
"""Values of keys without a default, for the commented file."""


def commented(settings: RobotSettings | None) -> str:
    """Return a file with all keys and their meaning; those without a value of their own are commented out."""
    given = {} if settings is None else settings.model_dump(exclude_unset=True, exclude_none=True)
    return "\n".join(_commented_lines(given)) + "\n"


def _commented_lines(given: dict[str, Any]) -> Iterator[str]:
    yield "# The robot of this folder, for all commands of rover-ncp. Paths count from this file's folder."
    for name, field in RobotSettings.model_fields.items():
        default = _EXAMPLES.get(name, field.default)
        line = dump_yaml({name: given.get(name, default)}).rstrip()
        yield ""
        yield from wrap(f"{field.description}", 100, initial_indent="# ", subsequent_indent="# ")
        yield line if name in given else "\n".join(f"#{each}" for each in line.splitlines())
