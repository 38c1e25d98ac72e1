"""The command ``export``; heavy libraries load only when it runs."""

import re
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from pydantic import BaseModel, Field

from rover_ncp.core.console import Json, Output, Overwrite, reject


class Exported(BaseModel):
    """Result of the command ``export``."""

    policy: str = Field(description="its name or file")
    to: str = Field(description="the format")
    name: str = Field(description="with which the names of the files begin")
    files: list[str] = Field(description="the files that were written")


class Target(StrEnum):
    """What a policy is exported to."""

    C = "c"
    YAML = "yaml"


def export(
    policy: Annotated[str, typer.Argument(help="Policy: a name or a YAML file.")],
    *,
    to: Annotated[
        Target,
        typer.Option(help="c: C99 sources. yaml: a policy file to edit."),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the files.")],
    course: Annotated[
        str | None,
        typer.Option(help="Course of the C sources, by name or YAML file.", show_default="parking"),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write a policy for other programs.

    To c: NAME.h and NAME.c turn the rover's pose on a course into an observation, and an observation into a
    command, without allocation or libraries beyond math.h; NAME_check.c tests a build. All are double unless
    ROVER_NCP_FLOAT is defined.

        rover-ncp export course --to c --out firmware
        cc -std=c99 -O2 -ffp-contract=off -o check firmware/*.c -lm && ./check

    To yaml: NAME.yaml, the policy file, to begin one of your own with (train --circuit NAME.yaml).
    """
    from rover_ncp.circuit.policy_file import load_policy, policy_to_yaml
    from rover_ncp.core.files import require_writable, write_atomic
    from rover_ncp.course.course import load_course
    from rover_ncp.export.c_sources import c_files

    if to is Target.YAML:
        reject("--to yaml needs no course", course=course)
    name = re.sub(r"[^a-z0-9]+", "_", Path(policy).stem.lower()).strip("_")[:64]
    name = name if name[:1].isalpha() else f"policy_{name}".rstrip("_")
    loaded = load_policy(policy)
    if to is Target.YAML:
        files = {f"{name}.yaml": policy_to_yaml(loaded)}
    else:
        files = c_files(loaded, name, load_course(course or "parking"))
    for file in files:
        require_writable(out / file, overwrite=overwrite)
    for file, content in files.items():
        write_atomic(out / file, content)
    paths = [str(out / file) for file in files]
    result = Exported(policy=policy, to=to, name=name, files=paths)
    Output(json).result(result, "\n".join(paths))
