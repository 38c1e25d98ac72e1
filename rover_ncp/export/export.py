"""The files of an exported policy, by target."""

from importlib.metadata import version

from pydantic import BaseModel, Field

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import policy_to_yaml
from rover_ncp.course.course import Course
from rover_ncp.course.reference import plan_reference
from rover_ncp.course.signals import needs_reference
from rover_ncp.export.circuit_c import circuit_files
from rover_ncp.export.course_c import course_files
from rover_ncp.export.vectors import check_file, drives, make_vectors


class Exported(BaseModel):
    """Result of the command ``export``."""

    policy: str = Field(description="its name or file")
    to: str = Field(description="the format")
    name: str = Field(description="with which the names of the files begin")
    files: list[str] = Field(description="the files that were written")


def exported(policy: Policy, to: str, name: str, course: Course) -> dict[str, str]:
    """Return the text of each file."""
    if to == "yaml":
        return {f"{name}.yaml": policy_to_yaml(policy)}
    reference = plan_reference(course) if needs_reference(policy.sensing.inputs) else None
    vectors = make_vectors(policy, course, reference)
    made_by = version("rover-ncp")
    files = circuit_files(policy, name, made_by)
    if drives(policy):
        files |= course_files(policy, course, reference, name, made_by)
    return files | {f"{name}_check.c": check_file(vectors, name)}
