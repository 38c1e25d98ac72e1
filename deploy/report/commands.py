"""The command ``course``; heavy libraries load only when it runs."""

import re
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from rover_ncp.core.console import Json, Output
from rover_ncp.core.errors import UsageError

PICTURES = (".png", ".svg")


class What(StrEnum):
    """Actions on a course."""

    NEW = "new"
    CHECK = "check"


def course(
    what: Annotated[What, typer.Argument(help="new: make one. check: can it be driven?")],
    source: Annotated[
        str,
        typer.Argument(
            help="new: poses (YAML, CSV) or a recorded drive (MCAP). check: a course by name or file."
        ),
    ],
    *,
    out: Annotated[
        Path | None,
        typer.Option(
            help="new: the course's file (YAML). check: a picture (PNG or SVG).", show_default=False
        ),
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="new: what the course is called.", show_default="the file's name")
    ] = None,
    json: Json = False,
) -> int:
    """Make a course, or check whether one can be driven, with place and reason if not.

    new takes the poses to drive through, or a drive that was recorded with 'rover-ncp teleop' or 'rover-ncp
    deploy', makes the first pose the origin and chooses deadlines that the motors (0.16 m/s, 0.18 rad/s) can
    meet. check compares any course with the motors, the rover's size and the obstacles.

        rover-ncp course new poses.csv --out mine.yaml
        rover-ncp course check mine.yaml --out mine.png

    Ends with 1 if the course cannot be driven; new writes its file all the same.
    """
    from rover_ncp.core.files import require_writable
    from rover_ncp.course.course import load_course
    from rover_ncp.course.feasibility import check_course

    output = Output(json)
    if what is What.NEW:
        made, found = _new(Path(source), out, name)
    else:
        if name is not None:
            raise UsageError("--name is for new")
        if out is not None and out.suffix not in PICTURES:
            raise UsageError(f"--out {out}: expected a picture, .png or .svg")
        if out is not None:
            require_writable(out)
        made = load_course(source)
        found = check_course(made)
        if out is not None:
            _draw(out, made, found)
    fields = {
        "course": made.name,
        "drivable": found.drivable,
        "problems": [vars(problem) | {"cause": problem.cause.value} for problem in found.problems],
        "checkpoints": len(made.checkpoints),
        "horizon_s": made.horizon_s,
        "worst_miss_m": max(miss.error_m for miss in found.misses),
        "worst_miss_rad": max(miss.error_rad for miss in found.misses),
        "clearance_m": found.clearance_m,
        "out": str(out) if out else None,
    }
    output.result(fields, _words(fields, found.problems))
    return 0 if found.drivable else 1


def _new(source: Path, out: Path | None, name: str | None) -> Any:
    from rover_ncp.core.files import require_writable, write_atomic
    from rover_ncp.course.builder import course_yaml, make_course, read_poses

    if out is None or out.suffix not in {".yaml", ".yml"}:
        raise UsageError("--out: expected the new course's file, .yaml")
    called = name or re.sub(r"[^a-z0-9_-]+", "-", out.stem.lower()).strip("-_") or "course"
    if not re.fullmatch(r"[a-z0-9][a-z0-9_-]{0,63}", called):
        raise UsageError(f"--name {called}: expected small letters, digits, - and _, at most 64")
    require_writable(out)
    made, found = make_course(called, source.name, read_poses(source))
    write_atomic(out, course_yaml(made))
    return made, found


def _draw(out: Path, made: Any, found: Any) -> None:
    from deploy.report.charts.path import course_picture
    from rover_ncp.core.files import write_atomic

    picture = course_picture(made, found)
    write_atomic(out, picture.png if out.suffix == ".png" else picture.svg)


def _words(fields: dict[str, Any], problems: Any) -> str:
    first = (
        f"{fields['course']}: {'' if fields['drivable'] else 'not '}drivable; {fields['checkpoints']} "
        f"checkpoints, {fields['horizon_s']:g} s; the nearest drive misses them by at most "
        f"{1000 * fields['worst_miss_m']:.0f} mm and {1000 * fields['worst_miss_rad']:.0f} mrad"
    )
    if fields["clearance_m"] is not None:
        first += f"; {1000 * fields['clearance_m']:.0f} mm from the nearest obstacle"
    return "\n".join([first, *map(str, problems), *([f"wrote {fields['out']}"] if fields["out"] else [])])
