"""The process that identifies a robot: drives it, and writes its profile."""

from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import Field

from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.drive.zenoh_link import ZenohLink
from deploy.identify.excitation import excite, steps
from deploy.identify.fit import identify
from deploy.identify.motion_log import motion_log
from deploy.recorder import Recorder
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.config import dump_yaml, name_from
from rover_ncp.core.console import Output
from rover_ncp.core.errors import FileError
from rover_ncp.core.files import require_writable, write_atomic
from rover_ncp.core.process import Interrupts
from rover_ncp.recording.recording import Recorded
from rover_ncp.robot.description import RobotDescription
from rover_ncp.robot.lasting_error import NOT_DECLARED
from rover_ncp.robot.profile import RoverProfile

SETTINGS_FILE = "identify.yaml"


class IdentifyResult(RoverProfile):
    """The profile, and its file."""

    out: str = Field(description="the file")


def identify_robot(
    address: BridgeAddress,
    recorder: Recorder,
    fence_m: float,
    out: Path,
    output: Output,
    *,
    robot: RobotDescription | None = None,
    overwrite: bool = False,
) -> int:
    """Drive a robot at speeds that its model reaches, write its profile, and return the exit code.

    The code is 1 when delays or gains could not be determined.
    Raises RoverNcpError or KeyboardInterrupt; the rover was stopped before.
    """
    require_writable(out, overwrite=overwrite)
    received: list[Recorded] = []

    def record(message: Recorded) -> None:
        received.append(message)
        recorder.put(message)

    with Interrupts() as interrupts, recorder, ZenohLink(address, record) as link:
        measurements = Measurements(link)
        monitor = SafetyMonitor(link, measurements, lambda: interrupts.raised)
        monitor.wait()
        output.say(link.other_model(robot))
        about: dict[str, Any] = {"version": version("rover-ncp"), "robot": address.robot}
        if robot is not None:
            about["described"] = robot.model_dump(mode="json")
        recorder.open({SETTINGS_FILE: dump_yaml(about).encode()})
        seconds = sum(step.seconds for step in steps(robot))
        output.say(f"driving for {seconds:.0f} s within {fence_m} m of here; Ctrl-C stops the rover")
        monitor.wait()  # what took long since the first wait is not odometry's age
        bands = excite(link, measurements, monitor, fence_m, robot=robot, begin=recorder.begin)
        base = link.about_base()
        model = (base and base.model) or (robot and robot.name)
        log = motion_log(received, robot, partial(link.lasting_error, robot=robot))
    if len(log.external.t) and not log.lasting.declared:
        error = log.lasting.values
        assumed = f"{100 * error.position_m:g} cm for {error.time_s:g} s are assumed"
        output.say(f"{NOT_DECLARED}: {assumed}, which shows less")
    profile = identify(log, name_from(out, "rover"), bands)
    made = {"from": address.robot, "version": version("rover-ncp")} | ({"model": model} if model else {})
    profile = profile.model_copy(update={"measured": made | profile.measured})
    write_atomic(out, dump_yaml(profile.model_dump(mode="json", exclude_none=True)))
    output.result(
        IdentifyResult(**profile.model_dump(), out=str(out)), "\n".join([*_lines(profile), str(out)])
    )
    if recorder.failure:  # the profile is not lost with it
        raise FileError(f"the recording failed: {recorder.failure}")
    needed = (profile.delay_v_s, profile.delay_omega_s, profile.gain_v, profile.gain_omega)
    return 0 if None not in needed else 1


def _lines(profile: RoverProfile) -> list[str]:
    """Return a line for each value, with its standard deviation, in SI units.

    >>> _lines(RoverProfile(name="rover", delay_v_s=0.14213, std={"delay_v_s": 0.00061}))
    ['delay_v_s                0.1421 ± 0.00061']
    """
    values = profile.model_dump(exclude={"format", "name", "std", "measured"}, exclude_none=True)
    return [
        f"{name:24} {value:.4g}" + (f" ± {std:.2g}" if (std := profile.std.get(name)) else "")
        for name, value in values.items()
    ]
