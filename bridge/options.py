"""The bridge's settings: the options of its command, and the robot's file for what they leave out."""

from pathlib import Path
from typing import NamedTuple

from bridge.bases import ChosenBase, choose_base, gate_limits
from bridge.gate.limits import Limits
from rover_ncp.core.config import validated
from rover_ncp.core.errors import ConfigError, FileError, UsageError
from rover_ncp.robot.robot_file import RobotFile, find_robot_file, missing, require_robot_file
from rover_ncp.wire.key_table import Role


class BridgeSettings(NamedTuple):
    """What the options of a bridge say, or the robot's file; None and "" are not given."""

    base: str | None = None
    listen: str | None = None
    namespace: str = ""
    model: str | None = None
    limits: Path | None = None
    """Their file, or the place in the robot's file."""
    own_limits: Limits | None = None
    """Those of the robot's file itself."""
    zenoh_config: Path | None = None
    base_zenoh_config: Path | None = None
    no_base_watchdog: bool = False
    measured_base_timeout_s: float | None = None
    source: str = ""
    """The robot's file that had something to add."""

    def chosen(self) -> ChosenBase:
        """Return the base. Raises UsageError, FileError or ConfigError."""
        if self.base is None:
            raise missing("a file; or --base, the robot's address")
        model = self.model or "auto"
        try:
            return choose_base(self.base, model, self.base_zenoh_config, self.measured_base_timeout_s)
        except UsageError as error:
            if not self.source or isinstance(error, ConfigError | FileError):
                raise
            raise UsageError(f"{self.source}: {error}") from error

    def gate_limits(self, chosen: ChosenBase) -> Limits:
        """Return the gate's limits for a base. Raises UsageError, FileError or ConfigError."""
        return gate_limits(self.limits, chosen.description, self.own_limits)


def settings_for(given: BridgeSettings, robot: str | None) -> BridgeSettings:
    """Return what options give, and what the robot's file has where they give nothing.

    Without ``robot`` the file in the working folder counts, unless a base is given. Raises UsageError,
    FileError or ConfigError.
    """
    if robot is not None:
        file = require_robot_file(robot)
    else:
        found = None if given.base is not None else find_robot_file(None)
        if found is None:
            return given
        file = found
    of_file = _of_file(file, given.base)
    if given.limits is not None:
        of_file = of_file._replace(own_limits=None)
    return given._replace(**{n: v for n, v in of_file._asdict().items() if not getattr(given, n)})


def _of_file(file: RobotFile, base: str | None) -> BridgeSettings:
    settings, limits = file.settings, file.limits
    own: Limits | None = None
    if isinstance(settings.limits, dict):
        limits = Path(f"{file.path}, $.limits")
        own = validated(settings.limits, Limits, str(limits))
    # What was measured and allowed holds for the file's own base alone.
    same = base is None or base == settings.base
    return BridgeSettings(
        base=base or file.need("base", "the bridge needs the robot's address, here or as --base"),
        listen=file.listen,
        namespace=settings.namespace,
        model=file.model,
        limits=limits,
        own_limits=own,
        zenoh_config=file.zenoh_config(Role.BRIDGE),
        base_zenoh_config=file.place_of(settings.base_zenoh_config),
        no_base_watchdog=same and settings.no_base_watchdog,
        measured_base_timeout_s=settings.measured_base_timeout_s if same else None,
        source=str(file.path),
    )
