"""The command ``course``; heavy libraries load only when it runs."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from rover_ncp.core.console import Json, Output, Overwrite, reject
from rover_ncp.core.errors import UsageError
from rover_ncp.core.files import DEFAULT_ROBOT


def course(
    what: Annotated[Literal["new", "check"], typer.Argument(help="new: make one. check: can it be driven?")],
    source: Annotated[
        str, typer.Argument(help="new: poses (YAML, CSV) or a recorded drive (MCAP). check: a course.")
    ],
    *,
    out: Annotated[
        Path | None,
        typer.Option(help="new: the course (YAML). check: a picture (PNG, SVG).", show_default=False),
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="new: what the course is called.", show_default="the file's name")
    ] = None,
    model: Annotated[
        str | None, typer.Option(help="check: the robot's description.", show_default=DEFAULT_ROBOT)
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> int:
    """Make a course, or check whether one can be driven, with place and reason if not.

    new takes the poses to drive through, or a drive that was recorded with 'rover-ncp teleop' or 'rover-ncp
    deploy', makes the first pose the origin and chooses deadlines that the motors (0.16 m/s, 0.18 rad/s) can
    meet. check compares any course with the motors, the rover's size and the obstacles; for a robot that is
    slower than a circuit's commands it takes longer, as in 'deploy'.

        rover-ncp course new poses.csv --out course.yaml
        rover-ncp course check course.yaml --out course.png

    Ends with 1 if the course cannot be driven; new writes its file all the same.
    """
    from rover_ncp.course.course import load_course
    from rover_ncp.course.feasibility import CourseResult, check_course
    from rover_ncp.course.reference import planning_notice
    from rover_ncp.course.slowdown import slowed
    from rover_ncp.robot.description import load_description

    output, pace = Output(json), ""
    if what == "new":
        reject("is for check", model=model)
        made, found = _new(Path(source), out, name, output.say, overwrite=overwrite)
    else:
        reject("is for new", name=name)
        if out is None:
            reject("needs --out", overwrite=overwrite)
        robot = load_description(model or DEFAULT_ROBOT)
        made, pace = slowed(load_course(source), robot)
        output.say(planning_notice(made))
        found = check_course(made, robot)
        if out is not None:
            _draw(out, made, found, robot, overwrite=overwrite)
    result = CourseResult(
        course=made.name,
        drivable=found.drivable,
        problems=found.problems,
        checkpoints=len(made.checkpoints),
        horizon_s=made.horizon_s,
        worst_miss_m=max(miss.error_m for miss in found.deviations),
        worst_miss_rad=max(miss.error_rad for miss in found.deviations),
        clearance_m=found.clearance_m,
        scaled=(pace,) if pace else (),
        out=str(out) if out else None,
    )
    words = (
        f"{made.name}: {'' if found.drivable else 'not '}drivable; {result.checkpoints} checkpoints, "
        f"{made.horizon_s:g} s; the nearest drive misses them by at most {1000 * result.worst_miss_m:.0f} mm "
        f"and {1000 * result.worst_miss_rad:.0f} mrad"
    )
    if found.clearance_m is not None:
        words += f"; {1000 * found.clearance_m:.0f} mm from the nearest obstacle"
    output.result(
        result,
        "\n".join([*result.scaled, words, *map(str, found.problems), *([f"wrote {out}"] if out else [])]),
    )
    return 0 if found.drivable else 1


def _new(
    source: Path, out: Path | None, name: str | None, say: Callable[[str], None], *, overwrite: bool
) -> Any:
    from rover_ncp.core.config import name_from
    from rover_ncp.core.files import require_writable, write_atomic
    from rover_ncp.course.builder import course_yaml, make_course, read_poses

    if out is None or out.suffix.lower() not in {".yaml", ".yml"}:
        raise UsageError("--out: expected the new course's file, .yaml")
    name = name or re.sub(r"[^a-z0-9_-]+", "-", name_from(out, "course").lower()).strip("-_") or "course"
    if not re.fullmatch(r"[a-z0-9][a-z0-9_-]{0,63}", name):
        raise UsageError(f"--name {name}: expected small letters, digits, - and _, at most 64")
    require_writable(out, overwrite=overwrite)
    made, found = make_course(name, source.name, read_poses(source), say)
    write_atomic(out, course_yaml(made))
    return made, found


def _draw(out: Path, made: Any, found: Any, robot: Any, *, overwrite: bool) -> None:
    from rover_ncp.core.files import require_writable, write_atomic
    from rover_ncp.course.pictures import course_picture, render
    from rover_ncp.course.shapes import outline_of

    form = out.suffix[1:].lower()
    if form not in {"png", "svg"}:
        raise UsageError(f"--out {out}: expected a picture, .png or .svg")
    require_writable(out, overwrite=overwrite)
    write_atomic(out, render(course_picture(made, found, outline_of(robot)), form))
