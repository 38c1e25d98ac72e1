"""The process that identifies a robot: drives it or reads a recording, and writes its profile."""

import math
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import Field

from deploy.drive.measurements import Measurements
from deploy.drive.records import CONFIG_FILE, attached_settings
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.drive.zenoh_link import ZenohLink
from deploy.identify.excitation import excite, steps
from deploy.identify.fit import identify
from deploy.identify.motion_log import motion_log
from deploy.recorder import Recorder
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.config import dump_yaml, name_from
from rover_ncp.core.console import Output, reject
from rover_ncp.core.errors import FileError
from rover_ncp.core.files import require_writable, write_atomic
from rover_ncp.core.process import Interrupts
from rover_ncp.recording.recording import Recorded, Recording, read_recording
from rover_ncp.robot.description import RobotDescription, load_description, recorded_robot
from rover_ncp.robot.profile import RoverProfile

SETTINGS_FILE = "identify.yaml"

_WORDS: dict[str, tuple[str, float, str]] = {
    "delay_v_s": ("delay of the speed", 1000.0, "ms"),
    "delay_omega_s": ("delay of the turn", 1000.0, "ms"),
    "gain_v": ("speed over command, by odometry", 1.0, ""),
    "gain_omega": ("turn over command, by odometry", 1.0, ""),
    "dead_band_v": ("least speed command that it follows", 1000.0, "mm/s"),
    "dead_band_omega": ("least turn command that it follows", 1000.0, "mrad/s"),
    "accel": ("acceleration", 1.0, "m/s²"),
    "decel": ("deceleration", 1.0, "m/s²"),
    "alpha": ("turning acceleration", 1.0, "rad/s²"),
    "alpha_decel": ("turning deceleration", 1.0, "rad/s²"),
    "noise_m": ("noise of positions", 1000.0, "mm"),
    "noise_rad": ("noise of headings", 1000.0, "mrad"),
    "odometry_distance": ("odometry's distance over the true one", 1.0, ""),
    "odometry_heading": ("odometry's turn over the true one", 1.0, ""),
    "wheel_mismatch_rad_m": ("wheel mismatch", 1000.0, "mrad/m"),
    "rotation_center_m": ("centre of rotation behind the middle", 1000.0, "mm"),
    "rotation_center_left_m": ("centre of rotation to the left of the middle", 1000.0, "mm"),
    "turn_asymmetry": ("asymmetry of turns, on this ground", 1000.0, "mrad/rad"),
    "downhill_x_m": ("slide ahead on a turn, on this ground", 1000.0, "mm/rad"),
    "downhill_y_m": ("slide to the left on a turn, on this ground", 1000.0, "mm/rad"),
    "slip_s": ("share of a turn that slips away", 1.0, "per rad/s"),
}
"""Of each value of a profile: its name, unit and factor for people."""


class IdentifyResult(RoverProfile):
    """The profile, and its file."""

    out: str = Field(description="the file")


def identify_recording(
    path: Path, out: Path, output: Output, *, model: str | None = None, overwrite: bool = False
) -> int:
    """Write a profile from the recording of a drive, and return the exit code. Raises RoverNcpError.

    ``model`` is the description of a robot whose recording holds none: it tells how odometry reports speeds.
    """
    require_writable(out, overwrite=overwrite)
    recording = read_recording(path)
    robot = _recorded_robot(recording)
    if robot is not None:
        reject(f"{path} holds the description of its robot, {robot.name}", model=model)
    elif model is not None:
        robot = load_description(model)
    return _write_profile(list(recording.messages), str(path), out, output, robot)


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
        excite(link, measurements, monitor, fence_m, robot=robot, begin=recorder.begin)
    code = _write_profile(received, address.robot, out, output, robot)
    if recorder.failure:  # the profile is not lost with it
        raise FileError(f"the recording failed: {recorder.failure}")
    return code


def _recorded_robot(recording: Recording) -> RobotDescription | None:
    """Return the description that deploy or identify recorded. Raises FileError and ConfigError."""
    for name in (CONFIG_FILE, SETTINGS_FILE):
        robot = recorded_robot(attached_settings(recording, name), f"{recording.path}, {name}")
        if robot is not None:
            return robot
    return None


def _write_profile(
    messages: list[Recorded],
    origin: str,
    out: Path,
    output: Output,
    robot: RobotDescription | None = None,
) -> int:
    """Return 1 when delays or gains could not be determined, else 0."""
    profile = identify(motion_log(messages, robot), name_from(out, "rover"))
    made = {"from": origin, "version": version("rover-ncp")} | ({"model": robot.name} if robot else {})
    profile = profile.model_copy(update={"measured": made | profile.measured})
    write_atomic(out, dump_yaml(profile.model_dump(mode="json", exclude_none=True)))
    result = IdentifyResult(**profile.model_dump(), out=str(out))
    output.result(result, "\n".join([*_lines(profile), str(out)]))
    needed = (profile.delay_v_s, profile.delay_omega_s, profile.gain_v, profile.gain_omega)
    return 0 if None not in needed else 1


def _lines(profile: RoverProfile) -> list[str]:
    """Return a line for each value, with its standard deviation."""
    values: dict[str, Any] = profile.model_dump()
    return [
        f"{words:40} {_number(values[name], profile.std.get(name), factor, unit)}"
        for name, (words, factor, unit) in _WORDS.items()
    ]


def _number(value: float | None, std: float | None, factor: float, unit: str) -> str:
    """Return a value ± its standard deviation, to the deviation's second digit.

    >>> _number(0.14213, 0.00061, 1000.0, "ms")
    '142.13 ± 0.61 ms'
    """
    if value is None:
        return "not known"
    if not std:
        return f"{value * factor:.4g} {unit}".rstrip()
    digits = max(0, 1 - math.floor(math.log10(std * factor)))
    return f"{value * factor:.{digits}f} ± {std * factor:.{digits}f} {unit}".rstrip()
