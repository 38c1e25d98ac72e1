"""The driving process: connects policy, link, recorder and drive, and reports the result."""

import gc
import sys
from uuid import uuid4

import numpy as np

from deploy.drive.config import DriveConfig
from deploy.drive.control_loop import Drive
from deploy.drive.controller import Controller, CourseMission
from deploy.drive.mission import Mission
from deploy.drive.records import TICKS_TOPIC, attachments
from deploy.drive.result import result_of
from deploy.drive.tick_messages import Publisher
from deploy.drive.zenoh_link import ZenohLink
from deploy.place.docking import Docking
from deploy.recorder import Recorder
from deploy.zenoh_client import BridgeAddress
from rover_ncp.circuit.own_policy import OwnPolicy
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.console import Output
from rover_ncp.core.geometry import ORIGIN, STANDSTILL
from rover_ncp.core.process import Interrupts
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.course.reference import planning_notice
from rover_ncp.course.signals import needs_reference
from rover_ncp.recording.recording import Recorded
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


def run(
    address: BridgeAddress,
    output: Output,
    *,
    policy: Policy | OwnPolicy,
    course: Course,
    config: DriveConfig,
    recorder: Recorder,
    period_s: float = TICK_S,
    staging: Policy | None = None,
) -> int:
    """Drive once, and return the exit code; ``period_s`` is how long a tick lasts by the clock.

    ``staging`` drives to the staging pose, if the settings name a place. A policy of a user drives courses
    alone, and its drive is not recorded. Raises RoverNcpError if the drive could not begin.
    """
    mission: Mission
    known = config.estimator, config.rover, config.described
    if needs_reference(policy.sensing.inputs if isinstance(policy, Policy) else policy.signals):
        output.say("" if staging else planning_notice(course))
    files, names = dict[str, bytes](), tuple[str, ...]()
    if isinstance(policy, OwnPolicy):
        controller = Controller(policy.signals, course, *known, runner=policy.runner())
        mission = CourseMission(controller, config)
    else:
        files, names = attachments(policy, course, config, staging), policy.circuit.neurons
        if staging is None:
            mission = CourseMission(Controller(policy, course, *known), config)
        else:
            mission = Docking(config, staging, policy)

    def record(message: Recorded) -> None:
        if message.topic == TICKS_TOPIC:  # without a tick it would only be in the way of the next recording
            recorder.begin()
        recorder.put(message)

    prepare_for_real_time()
    records = recorder.path is not None
    with (
        Interrupts() as interrupts,
        recorder,
        ZenohLink(address, recorder.put, shown=records) as link,
    ):
        publisher = Publisher(link, record, names, frame=mission.frame)
        drive = Drive(
            *(link, mission, publisher, config, lambda: interrupts.raised),
            period_s=period_s,
            id=uuid4().hex,
            begin=recorder.begin,
        )
        drive.wait()
        output.say(link.other_model(config.described))
        output.say(link.other_profile(config.rover))
        recorder.open(files)
        with output.live(lambda: drive.progress):
            drive.run()
    result = result_of(drive, recorder.fields | {"recording_dropped": recorder.dropped})
    if output.as_json and result.exit_code:
        output.say(result.words.splitlines()[0])  # stderr shows the reason for an exit code other than 0
    output.result(result, result.words)
    return result.exit_code


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
