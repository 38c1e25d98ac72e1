"""Result of a drive, as JSON and in words."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel, Field

from deploy.drive.control_loop import Drive
from deploy.estimator.inputs import Acceptance
from deploy.place.outcome import DockResult
from deploy.recorder import RecordingResult
from rover_ncp.core.console import printable
from rover_ncp.core.errors import INTERRUPTED
from rover_ncp.course.scoring import Parked


class Samples(BaseModel):
    """Counts of one kind of measurement."""

    taken: int = Field(description="received and decoded")
    unreadable: int = Field(description="that could not be decoded")
    doubtful: int = Field(description="not used: their stamps contradict those around them")


class Odometry(Samples):
    """Counts of odometry or of gyro readings."""

    rejected: int = Field(description="by the filter")


class Nis(BaseModel):
    """Mean normalised innovation squared of external poses; 3 if all is as assumed."""

    standing: float | None = Field(description="of external poses while the rover stood")
    moving: float | None = Field(description="of external poses while it moved")


class ExternalPoses(Samples):
    """Counts of external poses."""

    placed: bool = Field(description="whether they gave the start")
    used: int = Field(description="by the filter")
    refused: int = Field(description="outliers and values that are not finite")
    too_late: int = Field(description="older than the filter's history")
    dropped: int = Field(description="newer than odometry, when too many waited for it")
    nis: Nis = Field(description="normalised innovation squared; 3 if all is as assumed")


class Latency(BaseModel):
    """Time from the arrival of a sample to its command."""

    p50: float = Field(description="median")
    p99: float = Field(description="99th percentile")


class DriveResult(RecordingResult):
    """Result of a drive."""

    verdict: Parked | None = Field(
        description="parked, 'parked, uncertain' or not parked, by the estimate; null if it ended before"
    )
    probability: float | None = Field(description="that the rover is within the tolerances")
    state: str = Field(description="in which the drive ended")
    reason: str = Field(description="in words")
    stopped_by: str | None = Field(description="the safety rule")
    contact: str | None = Field(description="that the base reported: a pressed bumper or a stall")
    estimate_error_m: float | None = Field(description="of the estimate to the goal, at the end")
    estimate_error_rad: float | None = Field(description="of its heading")
    dock: DockResult | None = Field(description="how a drive to or from a place ended; null for a course")
    ticks: int = Field(description="steps of control, 0.1 s each")
    overruns: int = Field(description="ticks without fresh odometry, and ticks that did not run")
    tick_rate_hz: float = Field(description="reached over the whole drive")
    odometry_to_command_ms: Latency = Field(description="from a sample's arrival to its command")
    odometry: Odometry = Field(description="samples")
    gyro: Odometry = Field(description="readings")
    pose: ExternalPoses = Field(description="external poses")
    dry_run: bool = Field(description="whether no command was sent")
    recording_dropped: int = Field(description="messages that the recording lacks")
    exit_code: int = Field(description="of the command")

    @property
    def words(self) -> str:
        """The result for people."""
        if self.stopped_by:
            first = printable(self.reason) + (f"\n{self.dock}" if self.dock else "")
        elif self.dock is not None and self.estimate_error_m is not None:
            first = str(self.dock)
            if self.verdict is Parked.UNCERTAIN:  # only an undocking: a docking that is uncertain is a miss
                first += f"\n{self.verdict}: {self.reason}"
        elif self.estimate_error_m is None or self.estimate_error_rad is None:
            first = "interrupted; the rover was stopped"
        else:
            first = (
                f"{self.verdict}; by the estimate {1000 * self.estimate_error_m:.0f} mm and "
                f"{1000 * self.estimate_error_rad:.0f} mrad from the goal"
            )
            if self.reason:
                first += f"\n{self.reason}"
        latency = self.odometry_to_command_ms
        lines = [
            ("dry run, " if self.dry_run else "") + first,
            f"{self.ticks} ticks at {self.tick_rate_hz:.2f} Hz, {self.overruns} overruns; "
            f"odometry to command {latency.p50:.1f} ms (median), {latency.p99:.1f} ms (99 %)",
        ]
        if self.pose.taken and not self.pose.placed:
            lines.append("external poses came, but none while the rover stood at the start: none was used")
        if self.recording:
            lines.append(f"recording: {self.recording}")
        if self.recording_failure:
            lines.append(f"the recording failed, the drive went on without it: {self.recording_failure}")
        return "\n".join(lines)


def result_of(drive: Drive, recording: Mapping[str, Any]) -> DriveResult:
    """Return the result of a drive that is over; ``recording`` are the fields of its recording."""
    verdict, config = drive.verdict, drive.config
    if drive.stop is not None:
        code = drive.stop.exit_code
    elif verdict is None:
        code = INTERRUPTED
    else:
        fails = {Parked.NO, Parked.UNCERTAIN} if config.require_certainty else {Parked.NO}
        code = 1 if verdict.words in fails and not config.dry_run else 0
    p50, p99 = (np.percentile(drive.latencies_ns or [0], [50, 99]) / 1e6).tolist()
    estimator, outcomes = drive.mission.estimator, drive.mission.estimator.poses
    odometry, gyro, pose = (
        {name: getattr(drive.measurements, name)[topic] for name in ("taken", "unreadable", "doubtful")}
        for topic in ("odom", "imu", "pose")
    )
    return DriveResult(
        verdict=verdict.words if verdict else None,
        probability=verdict.probability if verdict else None,
        state=drive.phase.value,
        reason=drive.reason,
        stopped_by=drive.stop.rule if drive.stop else None,
        contact=drive.monitor.contact or None,
        estimate_error_m=verdict.error_m if verdict else None,
        estimate_error_rad=verdict.error_rad if verdict else None,
        odometry_to_command_ms=Latency(p50=p50, p99=p99),
        odometry=Odometry(**odometry, rejected=estimator.rejected),
        gyro=Odometry(**gyro, rejected=estimator.gyro_rejected),
        pose=ExternalPoses(
            **pose,
            placed=drive.placed,
            used=outcomes[Acceptance.ACCEPTED],
            refused=outcomes[Acceptance.OUTLIER]
            + outcomes[Acceptance.NOT_FINITE]
            + outcomes[Acceptance.REPEATED],
            too_late=outcomes[Acceptance.TOO_OLD],
            dropped=outcomes[Acceptance.DROPPED],
            nis=Nis(**estimator.nis),
        ),
        dock=drive.mission.result(drive.reason),
        dry_run=config.dry_run,
        exit_code=code,
        **drive.keeper.report()._asdict(),
        **recording,
    )
