"""The process that identifies a robot: drives it or reads a recording, and writes its profile."""

import math
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from deploy.drive.link import Link
from deploy.drive.measurements import Intake
from deploy.drive.safety_monitor import Guard, Interrupted
from deploy.drive.waits import Waits
from deploy.identify.excitation import excite, steps
from deploy.identify.fit import identify
from deploy.identify.motion_log import motion_log
from deploy.recording_buffer import Tape
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.console import Output
from rover_ncp.core.errors import FileError, UsageError
from rover_ncp.core.files import require_writable, write_atomic
from rover_ncp.core.process import Interrupts
from rover_ncp.core.recording import Recorded, read_recording
from rover_ncp.core.robot_profile import RoverProfile

SETTINGS_FILE = "identify.yaml"


@dataclass(frozen=True)
class Options:
    """The command line of ``rover-ncp identify``; either a recording or a robot."""

    recording: Path | None
    robot: str | None
    out: Path
    fence_m: float
    record: Path | None
    overwrite: bool
    namespace: str
    zenoh_config: Path | None


def run(options: Options, output: Output) -> int:
    """Identify, and return the exit code: 1 when delays or gains could not be determined.

    Raises RoverNcpError on failure; a rover that was driven was stopped before.
    """
    if (options.recording is None) == (options.robot is None):
        raise UsageError("expected either --robot to drive one, or a recording of a drive")
    require_writable(options.out)
    if options.recording is not None:
        if options.record is not None:
            raise UsageError("--record goes with --robot")
        messages = list(read_recording(options.recording).messages)
        origin = str(options.recording)
    else:
        messages = _driven(options, str(options.robot), output)
        origin = str(options.robot)
    profile = identify(motion_log(messages), options.out.stem)
    made = {"from": origin, "version": version("rover-ncp")}
    profile = profile.model_copy(update={"measured": made | profile.measured})
    write_atomic(options.out, dump_yaml(profile.model_dump(mode="json", exclude_none=True)))
    fields = profile.model_dump(mode="json", exclude={"format"})
    output.result(fields | {"out": str(options.out)}, "\n".join([*_words(profile), str(options.out)]))
    known = (profile.delay_v_s, profile.delay_omega_s, profile.gain_v, profile.gain_omega)
    return 0 if None not in known else 1


def _driven(options: Options, robot: str, output: Output) -> list[Recorded]:
    """Drive a robot, and return all received messages. Raises KeyboardInterrupt on a termination signal."""
    heard: list[Recorded] = []
    tape = Tape(options.record, overwrite=options.overwrite)

    def record(message: Recorded) -> None:
        heard.append(message)
        tape.put(message)

    with Interrupts() as interrupts:
        try:
            with Link(robot, options.namespace, options.zenoh_config, record) as link:
                intake = Intake(link.odometry)
                guard = Guard(link, intake, Waits(), lambda: interrupts.raised)
                try:
                    guard.wait(drives=True, namespace=options.namespace)
                    about = {"version": version("rover-ncp"), "robot": robot}
                    tape.roll({SETTINGS_FILE: dump_yaml(about).encode()})
                    seconds = sum(step.seconds for step in steps())
                    output.say(
                        f"driving for {seconds:.0f} s within {options.fence_m} m of here; Ctrl-C stops it"
                    )
                    excite(link, intake, guard, options.fence_m)
                except Interrupted as interruption:
                    raise KeyboardInterrupt from interruption  # the rover was stopped
        finally:
            tape.close()
    if tape.recorder is not None and tape.recorder.failure:
        raise FileError(f"the recording failed: {tape.recorder.failure}")
    return heard


def _words(profile: RoverProfile) -> list[str]:
    """Return the profile for people: a line for each value, with its standard deviation."""
    names: dict[str, tuple[str, float, str]] = {
        "delay_v_s": ("delay of the speed", 1000.0, "ms"),
        "delay_omega_s": ("delay of the turn", 1000.0, "ms"),
        "gain_v": ("speed over command, by odometry", 1.0, ""),
        "gain_omega": ("turn over command, by odometry", 1.0, ""),
        "accel": ("acceleration", 1.0, "m/s²"),
        "alpha": ("turning acceleration", 1.0, "rad/s²"),
        "noise_m": ("noise of positions", 1000.0, "mm"),
        "noise_rad": ("noise of headings", 1000.0, "mrad"),
        "odometry_distance": ("odometry's distance over the true one", 1.0, ""),
        "odometry_heading": ("odometry's turn over the true one", 1.0, ""),
        "imbalance_rad_m": ("unseen turn on the way", 1000.0, "mrad/m"),
        "slip_s": ("share of a turn that slips away", 1.0, "per rad/s"),
    }
    values: dict[str, Any] = profile.model_dump()
    return [
        f"{words:40} {_number(values[name], profile.std.get(name), factor, unit)}"
        for name, (words, factor, unit) in names.items()
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
