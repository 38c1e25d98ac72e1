"""What a drive is: its settings, and the files that go into its recording."""

from importlib.metadata import version
from typing import Literal

from pydantic import Field

from deploy.estimator import EstimatorSettings
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import policy_from_yaml, policy_to_yaml
from rover_ncp.core.config import StrictModel, dump_yaml, parse_yaml
from rover_ncp.core.course import Course
from rover_ncp.core.errors import FileError
from rover_ncp.core.recording import Recording

__all__ = ["CONFIG_FILE", "COURSE_FILE", "POLICY_FILE", "DriveConfig", "PoseUse", "attached", "attachments"]

POLICY_FILE, COURSE_FILE, CONFIG_FILE = "policy.yaml", "course.yaml", "deploy.yaml"

PoseUse = Literal["auto", "required", "none"]
"""Whether external poses place the rover: if they come, in any case, or never."""


class DriveConfig(StrictModel):
    """The settings of one drive; times in s."""

    format: int = Field(default=1, ge=1, le=1)
    version: str = Field(default_factory=lambda: version("rover-ncp"))
    robot: str
    namespace: str
    policy: str
    course: str
    dry_run: bool
    ticks: int = Field(ge=1, description="how many control ticks the drive lasts at most")
    bridge_wait_s: float = Field(default=5.0, gt=0, description="for the bridge to show itself")
    permission_wait_s: float = Field(default=2.0, gt=0, description="for the bridge to want our commands")
    odometry_wait_s: float = Field(default=5.0, gt=0, description="for the first odometry")
    still_wait_s: float = Field(default=10.0, gt=0, description="for the rover to stand still")
    still_s: float = Field(default=1.0, gt=0, description="so long it stands still before the start")
    still_m: float = Field(default=0.003, gt=0)
    still_rad: float = Field(default=0.005, gt=0)
    odometry_age_s: float = Field(default=0.4, gt=0, le=0.5, description="older odometry stops the rover")
    pose: PoseUse = "auto"
    pose_wait_s: float = Field(default=10.0, gt=0, description="for the first external pose, if required")
    lease_wait_s: float = Field(default=1.0, gt=0, description="for the gate to confirm our lease")
    estimator: EstimatorSettings = EstimatorSettings()


def attachments(policy: Policy, course: Course, config: DriveConfig) -> dict[str, bytes]:
    """Return the files that go into the recording, by name."""
    return {
        POLICY_FILE: policy_to_yaml(policy).encode(),
        COURSE_FILE: dump_yaml(course.model_dump(mode="json")).encode(),
        CONFIG_FILE: dump_yaml(config.model_dump(mode="json")).encode(),
    }


def attached(recording: Recording) -> tuple[Policy, Course, DriveConfig]:
    """Read policy, course and settings from a recording. Raises FileError and ConfigError."""
    texts = {}
    for name in (POLICY_FILE, COURSE_FILE, CONFIG_FILE):
        try:
            texts[name] = recording.attachment(name).decode()
        except UnicodeDecodeError as error:
            raise FileError(f"{recording.path}: its {name} is no text") from error
    where = {name: f"{recording.path}, {name}" for name in texts}
    return (
        policy_from_yaml(texts[POLICY_FILE], where[POLICY_FILE]),
        parse_yaml(texts[COURSE_FILE], Course, where[COURSE_FILE]),
        parse_yaml(texts[CONFIG_FILE], DriveConfig, where[CONFIG_FILE]),
    )
