"""The driving process: connects policy, link, recorder and drive, and reports the result."""

import gc
import sys
import zlib
from typing import Any

import numpy as np

from deploy.drive.config import DriveConfig
from deploy.drive.control_loop import Drive
from deploy.drive.controller import ORIGIN, Controller
from deploy.drive.publisher import Publisher
from deploy.drive.records import attachments
from deploy.drive.zenoh_link import ZenohLink
from deploy.recorder import Recorder
from deploy.zenoh_client import BridgeAddress
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.console import Output, printable
from rover_ncp.core.geometry import Velocity
from rover_ncp.core.process import Interrupts
from rover_ncp.course.course import TICK_S, Course, Parked
from rover_ncp.wire.messages import (
    COURSE_FRAME,
    neurons,
    odometry,
    pose_with_covariance,
    read_odometry,
    text,
    twist_stamped,
)

SWITCH_INTERVAL_S = 0.0005
"""How long another thread may keep the interpreter from the control loop (Python's default is 5 ms)."""
INTERRUPTED = 130
STANDSTILL = Velocity(0.0, 0.0)


def run(
    address: BridgeAddress,
    output: Output,
    *,
    policy: Policy,
    course: Course,
    config: DriveConfig,
    recorder: Recorder,
    period_s: float = TICK_S,
) -> int:
    """Drive once, and return the exit code; ``period_s`` is how long a tick lasts by the clock.

    Raises RoverNcpError if the drive could not begin.
    """
    controller = Controller(policy, course, config.estimator, config.rover)
    files = attachments(policy, course, config)
    prepare_for_real_time()
    with Interrupts() as interrupts, recorder, ZenohLink(address, recorder.put) as link:
        publisher = Publisher(link, recorder.put, policy.circuit.neurons)
        drive = Drive(link, controller, publisher, config, lambda: interrupts.raised, period_s=period_s)
        drive.wait()
        if config.described is not None:
            output.say(link.other_model(config.described))
        recorder.open(files)
        with output.live(lambda: drive.progress):
            try:
                drive.run({name: zlib.crc32(content) for name, content in files.items()})
            finally:
                if drive.estimate is None:  # no tick: the recording would only be in the way of the next
                    recorder.discard()
    fields = _result(drive, config) | {
        **recorder.fields,
        "recording_dropped": recorder.dropped,  #: messages that the recording lacks
    }
    words = _words(fields)
    if output.as_json and fields["exit_code"]:
        output.say(words.splitlines()[0])  # stderr shows the reason for an exit code other than 0
    output.result(fields, words)
    return int(fields["exit_code"])


def prepare_for_real_time() -> None:
    """Do slow first-time work before the ticks start."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    # Writers and readers of message types are made on first use, 10 ms each and 200 ms for the first.
    read_odometry(odometry(ORIGIN, STANDSTILL, 0))
    twist_stamped(STANDSTILL, 0)
    pose_with_covariance(ORIGIN, np.zeros((3, 3)), 0, COURSE_FRAME)
    neurons([0.0], ["-"])
    text("")
    # Exclude loaded objects from garbage collection: a full pass over them would take 200 ms. What an earlier
    # drive of this process excluded is collected first.
    gc.unfreeze()
    gc.collect()
    gc.freeze()


def _result(drive: Drive, config: DriveConfig) -> dict[str, Any]:
    report, verdict = drive.keeper.report(), drive.verdict
    if drive.stop is not None:
        code = drive.stop.exit_code
    elif verdict is None:
        code = INTERRUPTED
    else:
        fails = {Parked.NO, Parked.UNCERTAIN} if config.require_certainty else {Parked.NO}
        code = 1 if verdict.words in fails and not config.dry_run else 0
    latencies_ms = np.array(drive.latencies_ns or [0]) / 1e6
    return {
        #: parked, "parked, uncertain" or not parked, by the estimate; null if the drive did not reach its end
        "verdict": verdict.words.value if verdict else None,
        "probability": verdict.probability if verdict else None,  #: that the rover is within the tolerances
        "state": drive.phase.value,  #: in which the drive ended
        "reason": drive.reason,  #: in words
        "stopped_by": drive.stop.rule if drive.stop else None,  #: the safety rule
        "warning": drive.warning or None,  #: a second publisher of odom, imu or pose
        "contact": drive.contact or None,  #: that the base reported: a pressed bumper or a stall
        #: in 95 % of drives, by the filter's covariance, if no external pose comes after the start
        "predicted_error_m": drive.predicted_error_m,
        "estimate_error_m": verdict.error_m if verdict else None,  #: of the estimate to the goal, at the end
        "estimate_error_rad": verdict.error_rad if verdict else None,  #: of its heading
        **{name: getattr(report, name) for name in ("ticks", "overruns", "predicted", "missed")},
        "tick_rate_hz": report.rate_hz,
        "lateness_ms": {"p50": report.lateness_p50_ms, "max": report.lateness_max_ms},  #: of ticks
        "odometry_to_command_ms": {  #: from a sample's arrival to its command
            "p50": float(np.percentile(latencies_ms, 50)),
            "p99": float(np.percentile(latencies_ms, 99)),
        },
        **drive.measurements_used,
        "policy": config.policy,  #: its name
        "course": config.course,  #: its name
        "dry_run": config.dry_run,  #: whether no command was sent
        "exit_code": code,
    }


def _words(fields: dict[str, Any]) -> str:
    """Return the result for people."""
    if fields["stopped_by"]:
        first = printable(fields["reason"])
    elif fields["estimate_error_m"] is None:
        first = "interrupted; the rover was stopped"
    else:
        first = (
            f"{fields['verdict']}; by the estimate {1000 * fields['estimate_error_m']:.0f} mm and "
            f"{1000 * fields['estimate_error_rad']:.0f} mrad from the goal"
        )
        if fields["reason"]:
            first += f"\n{fields['reason']}"
    latency = fields["odometry_to_command_ms"]
    lines = [
        ("dry run, " if fields["dry_run"] else "") + first,
        f"{fields['ticks']} ticks at {fields['tick_rate_hz']:.2f} Hz, {fields['overruns']} overruns; "
        f"odometry to command {latency['p50']:.1f} ms (median), {latency['p99']:.1f} ms (99 %)",
    ]
    if fields["warning"]:
        lines.append(f"warning: {fields['warning']}")
    pose = fields["pose"]
    if pose["taken"] and not pose["placed"]:
        lines.append("external poses came, but none while the rover stood at the start: none was used")
    if fields["recording"]:
        lines.append(f"recording: {fields['recording']}")
    if fields["recording_failure"]:
        lines.append(f"the recording failed, the drive went on without it: {fields['recording_failure']}")
    return "\n".join(lines)
