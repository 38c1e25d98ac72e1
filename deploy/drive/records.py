"""Records of each tick in a recording, from which `replay` repeats the same arithmetic on the same numbers.

JSON on two topics that exist in recordings only. They do not repeat the measurements: a record names the
samples that the controller used, with the moment of measurement that it gave them.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from deploy.drive.config import DriveConfig
from deploy.drive.measurements import SampleRef
from deploy.place.outcome import Evidence
from deploy.place.room import Room
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import policy_from_yaml, policy_to_yaml
from rover_ncp.core.config import StrictModel, dump_yaml, parse_yaml, read_yaml
from rover_ncp.core.errors import FileError
from rover_ncp.course.course import Course
from rover_ncp.recording import recorded
from rover_ncp.recording.recording import Recording
from rover_ncp.robot.lasting_error import UNDECLARED, LastingError

if TYPE_CHECKING:
    from deploy.estimator.estimator import Estimate  # loads scipy, which a page does not need

POLICY_FILE, COURSE_FILE, CONFIG_FILE = "policy.yaml", "course.yaml", "deploy.yaml"
STAGING_FILE = "staging.yaml"
"""The policy that drives to the staging pose of a place; ``policy.yaml`` then is the one that docks."""
START_TOPIC = "deploy/start"
TICKS_TOPIC = recorded.TICKS_TOPIC


class StartRecord(StrictModel, extra="ignore"):
    """The start of a drive: at ``pose`` in the course's frame, at the moment of ``sample``.

    ``covariance`` of that pose has nine numbers, row by row; None where the pose defines the course's frame.
    ``lasting`` is the lasting error of the external poses, ``room`` that of the gate's fence.
    Recordings of earlier versions have checksums of their files here, which are ignored.
    """

    sample: SampleRef
    pose: tuple[float, float, float]
    covariance: tuple[float, ...] | None = Field(default=None, min_length=9, max_length=9)
    lasting: LastingError = UNDECLARED
    room: Room | None = None

    @property
    def covariance_matrix(self) -> NDArray[np.float64] | None:
        """The covariance (3, 3)."""
        return None if self.covariance is None else np.array(self.covariance).reshape(3, 3)


class TickRecord(StrictModel):
    """One tick: its inputs, in the order in which they were applied, and its outputs.

    ``now_ns`` is the tick's moment on the driver's monotonic clock, ``wall_ns`` the same by the wall clock
    (it stamps the messages). ``estimate`` is x, y, theta, v, omega. ``command`` is v, omega, or None for the
    last look at the horizon, when the circuit does not run. ``sequence`` is that of the command on the wire,
    None if none was sent. ``evidence`` is what the base reported to a docking; None for a course.
    """

    index: int
    now_ns: int
    wall_ns: int
    samples: tuple[SampleRef, ...]
    predicted: bool
    estimate: tuple[float, float, float, float, float]
    command: tuple[float, float] | None
    sequence: int | None
    evidence: Evidence | None = None


def numbers(estimate: "Estimate") -> tuple[float, float, float, float, float]:
    """Return an estimate as its record keeps it."""
    return (*estimate.pose, *estimate.velocity)


def attachments(
    policy: Policy, course: Course, config: DriveConfig, staging: Policy | None = None
) -> dict[str, bytes]:
    """Return the files that go into the recording, by name."""
    files = {
        POLICY_FILE: policy_to_yaml(policy).encode(),
        COURSE_FILE: dump_yaml(course.model_dump(mode="json")).encode(),
        CONFIG_FILE: dump_yaml(config.model_dump(mode="json")).encode(),
    }
    return files if staging is None else files | {STAGING_FILE: policy_to_yaml(staging).encode()}


def attached(recording: Recording) -> tuple[Policy, Course, DriveConfig]:
    """Read policy, course and settings from a recording. Raises FileError and ConfigError."""
    policy, course = attached_policy(recording), attached_course(recording)
    where = f"{recording.path}, {CONFIG_FILE}"
    return policy, course, _drive_config(attached_text(recording, CONFIG_FILE), where)


def attached_course(recording: Recording) -> Course:
    """Read a course from a recording. Raises FileError and ConfigError."""
    return parse_yaml(attached_text(recording, COURSE_FILE), Course, f"{recording.path}, {COURSE_FILE}")


def attached_settings(recording: Recording) -> dict[str, Any]:
    """Read a driver's settings as they are; {} if there are none. Raises FileError and ConfigError."""
    if CONFIG_FILE not in recording.attachments:
        return {}
    settings = read_yaml(attached_text(recording, CONFIG_FILE), f"{recording.path}, {CONFIG_FILE}")
    return settings if isinstance(settings, dict) else {}


def attached_policy(recording: Recording, name: str = POLICY_FILE) -> Policy:
    """Read a policy from a recording. Raises FileError and ConfigError."""
    return policy_from_yaml(attached_text(recording, name), f"{recording.path}, {name}")


def attached_text(recording: Recording, name: str) -> str:
    """Return an attachment that is text. Raises FileError."""
    try:
        return recording.attachment(name).decode()
    except UnicodeDecodeError as error:
        raise FileError(f"{recording.path}: its {name} is not text") from error


def _drive_config(text: str, where: str) -> DriveConfig:
    settings = read_yaml(text, where)
    if isinstance(settings, dict) and settings.get("format") in {1, 2, 3, 4}:
        raise FileError(
            f"{where}: format {settings['format']}, expected 5: recordings of an older estimator cannot be "
            "replayed"
        )
    return parse_yaml(text, DriveConfig, where)
