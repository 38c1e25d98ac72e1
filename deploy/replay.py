"""Replay: run a recording through the same controller again, and compare each estimate and command.

Bit for bit: the same odometry, at the same recorded moments, through the same policy must give the same
estimates and commands. A difference is reported with tick, quantity and both values.
"""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from pydantic import BaseModel, Field

from deploy.drive.controller import Controller, CourseMission
from deploy.drive.measurements import Sample, SampleRef, readers
from deploy.drive.mission import Mission
from deploy.drive.records import (
    STAGING_FILE,
    START_TOPIC,
    TICKS_TOPIC,
    StartRecord,
    TickRecord,
    attached,
    attached_policy,
    numbers,
)
from deploy.place.docking import Docking
from rover_ncp.core.errors import FileError, FormatError
from rover_ncp.core.geometry import Pose
from rover_ncp.recording.recording import Recording, read_recording
from rover_ncp.wire.messages import OdometrySample, read_text
from rover_ncp.wire.protocol import parse_json

QUANTITIES = (
    *("estimate x", "estimate y", "estimate theta", "estimate v", "estimate omega"),
    *("command v", "command omega"),
)
ABSENT = "absent"
INPUTS = {"odom": "odometry", "imu": "gyro reading", "pose": "external pose"}
"""Inputs of a tick, by topic."""
TOPICS = {*INPUTS, START_TOPIC, TICKS_TOPIC}


class Difference(BaseModel):
    """First difference between recording and recomputation."""

    tick: int | None = Field(description="null if it belongs to none")
    quantity: str = Field(description="what differs")
    recorded: str = Field(description="the value in the recording")
    recomputed: str = Field(description="the value now")

    def __str__(self) -> str:
        where = "" if self.tick is None else f"tick {self.tick}: "
        return f"{where}{self.quantity} is {self.recorded} in the recording, {self.recomputed} now"


class Comparison(BaseModel):
    """Result of a replay; the rest of a recording that was cut off is compared."""

    same: bool = Field(description="to the last bit")
    ticks: int = Field(description="that were compared")
    complete: bool = Field(description="false for a recording that was cut off")
    difference: Difference | None = Field(description="the first one")

    def __str__(self) -> str:
        cut = "" if self.complete else " (the recording was cut off; the rest was compared)"
        found = f"{self.ticks} ticks, all the same to the last bit" if self.same else "differs: "
        return f"{found}{self.difference or ''}{cut}"


def _differs(tick: int | None, quantity: str, recorded: str, recomputed: str) -> Difference:
    return Difference(tick=tick, quantity=quantity, recorded=recorded, recomputed=recomputed)


def replay(path: Path) -> Comparison:
    """Recompute a recording with its own policy. Raises FileError and ConfigError."""
    recording = read_recording(path, topics=TOPICS)
    policy, course, config = attached(recording)
    start, ticks = _records(recording)
    if config.place is None:
        controller = Controller(policy, course, config.estimator, config.rover, config.described)
        mission: Mission = CourseMission(controller, config)
    else:
        mission = Docking(config, attached_policy(recording, STAGING_FILE), policy)
    ticks_done, difference = 0, None
    samples = _samples(recording, mission.frame)
    for record, difference in _compared(recording, samples, mission, start, ticks):
        if difference is not None:
            break
        ticks_done += record.command is not None
    same = difference is None
    return Comparison(same=same, ticks=ticks_done, complete=recording.complete, difference=difference)


def _records(recording: Recording) -> tuple[StartRecord, list[TickRecord]]:
    try:
        starts = [parse_json(StartRecord, read_text(m.data)) for m in recording.topic(START_TOPIC)]
        ticks = [parse_json(TickRecord, read_text(m.data)) for m in recording.topic(TICKS_TOPIC)]
    except FormatError as error:
        raise FileError(f"{recording.path}: {error}") from error
    if len(starts) != 1 or not ticks:
        raise FileError(
            f"{recording.path}: holds no drive to recompute ({len(starts)} starts, {len(ticks)} ticks)"
        )
    return starts[0], ticks


def _compared(
    recording: Recording,
    samples: dict[tuple[str, int, int], Sample],
    mission: Mission,
    start: StartRecord,
    records: list[TickRecord],
) -> Iterator[tuple[TickRecord, Difference | None]]:
    """Run tick by tick; yield each record with its first difference. Ends where a cut-off file does."""
    for record in records:
        wanted = [start.sample, *record.samples] if record is records[0] else list(record.samples)
        missing = [ref for ref in wanted if _key(ref) not in samples]
        if missing and not recording.complete:
            return  # the writer was killed before it wrote this tick's inputs
        if missing:
            quantity = f"the {INPUTS[missing[0].topic]} of stamp {missing[0].stamp_ns}"
            yield record, _differs(record.index, quantity, ABSENT, "needed")
            return
        now = start.sample.seconds_to(record.now_ns)
        try:
            if record is records[0]:
                began = samples[_key(wanted.pop(0))]
                if not isinstance(began, OdometrySample):
                    raise ValueError("it does not start with odometry")
                pose, covariance = Pose(*start.pose), start.covariance_matrix
                mission.start(began.pose, 0.0, pose, covariance, start.lasting, room=start.room)
            for ref in wanted:
                mission.take(samples[_key(ref)], start.sample.seconds_to(ref.measured_ns))
            tick = mission.tick(record.index, now, record.evidence) if record.command is not None else None
            estimate = tick.estimate if tick else mission.record_estimate(record.index, now)
        except ValueError as error:  # such as a start that is not finite
            raise FileError(f"{recording.path}: tick {record.index} cannot be recomputed: {error}") from error
        recomputed = (*numbers(estimate), *(tick.command if tick else ()))
        yield record, _unequal(record.index, (*record.estimate, *(record.command or ())), recomputed)


def _key(ref: SampleRef) -> tuple[str, int, int]:
    """Return what tells samples apart: of 180,000 an hour, four have the checksum of another."""
    return ref.topic, ref.stamp_ns, ref.crc


def _samples(recording: Recording, pose_frame: str) -> dict[tuple[str, int, int], Sample]:
    """Return the readable inputs of a recording."""
    found = {}
    for topic, read in readers(pose_frame).items():
        for message in recording.topic(topic):
            with contextlib.suppress(FormatError):
                sample = read(message.data)
                found[_key(SampleRef.of(sample.stamp_ns, message.data, 0, topic))] = sample
    return found


def _unequal(tick: int, recorded: Sequence[float], recomputed: Sequence[float]) -> Difference | None:
    """Return the first number of a tick of which a bit differs."""
    for quantity, before, now in zip(QUANTITIES, recorded, recomputed, strict=False):
        if np.float64(before).tobytes() != np.float64(now).tobytes():
            return _differs(tick, quantity, repr(float(before)), repr(float(now)))
    return None
