"""Options that several commands of this package share, and the robot that they choose."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rover_ncp.wire.key_table import Role

if TYPE_CHECKING:
    from deploy.place.place import Place
    from deploy.place.sight import Sight
    from deploy.zenoh_client import BridgeAddress
    from rover_ncp.robot.description import RobotDescription
    from rover_ncp.robot.robot_file import RobotFile

Robot = Annotated[
    str | None,
    typer.Option(
        help="A robot's file (YAML), or where its bridge listens: PROTOCOL/HOST[:PORT], such as "
        "tcp/192.168.1.20.",
        show_default="robot.yaml in this folder",
    ),
]
Namespace = Annotated[str, typer.Option(help="The robot's namespace, such as bot1.")]
ZenohConfig = Annotated[Path | None, typer.Option(help="Zenoh configuration (JSON5) with certificates.")]


@dataclass(frozen=True)
class ChosenRobot:
    """The robot of a command: its bridge, its description, and its file if it has one."""

    address: "BridgeAddress"
    model: str | None
    file: "RobotFile | None"

    @property
    def described(self) -> "RobotDescription | None":
        """The description, None if none is named. Raises FileError or ConfigError."""
        from rover_ncp.robot.description import load_description

        return load_description(self.model) if self.model else None

    @property
    def places(self) -> Path:
        """Folder of the robot's places: the working folder without a file."""
        return Path() if self.file is None else self.file.path.parent / self.file.settings.places

    def sight(self, place: "Place") -> "Sight | None":
        """Return the localiser's camera and the tags of a place; None if the files do not say where they are.

        A camera of ROS has no file, and that of another machine may not be here. Raises FileError or
        ConfigError.
        """
        from deploy.tag.board import load_tags
        from deploy.tag.field_of_view import sight_of
        from deploy.tag.tag_map import CameraFile
        from rover_ncp.core.config import load_yaml

        settings = None if self.file is None else self.file.settings
        if self.file is None or settings is None or settings.camera is None:
            return None
        camera, tags = self.file.place_of(settings.camera.file), self.file.tags
        if camera is None or tags is None or not camera.exists():
            return None
        return sight_of(load_yaml(camera, CameraFile), load_tags(tags), place)


def choose_robot(
    robot: str | None,
    namespace: str,
    zenoh_config: Path | None,
    model: str | None = None,
    role: Role = Role.DRIVER,
) -> ChosenRobot:
    """Return the robot that options name; what they leave out is that of the robot's file.

    Raises UsageError, FileError or ConfigError.
    """
    from deploy.zenoh_client import BridgeAddress
    from rover_ncp.robot.robot_file import find_robot_file, missing

    file = find_robot_file(robot)
    if file is None:
        if robot is None:
            raise missing("a file, or an address such as tcp/192.168.1.20")
        return ChosenRobot(BridgeAddress(robot, namespace, zenoh_config), model, None)
    return ChosenRobot(
        BridgeAddress(
            file.address, namespace or file.settings.namespace, zenoh_config or file.zenoh_config(role)
        ),
        model or file.model,
        file,
    )
