"""The command ``park``; heavy libraries load only when it runs."""

from pathlib import Path
from typing import Annotated

import typer

from rover_ncp.core.console import MAX_SEED, Json, Output, Overwrite, reject
from rover_ncp.core.files import DEFAULT_ROBOT


def park(
    *,
    policy: Annotated[
        str | None,
        typer.Option(
            help="Park with this policy (name or file) instead of training one.", show_default=False
        ),
    ] = None,
    course: Annotated[str, typer.Option(help="Course to drive, by name or YAML file.")] = "parking",
    model: Annotated[
        str,
        typer.Option(
            help="The mock robot's description, a name or a file. A ROS 2 robot is parked with the policy "
            "course unless --policy names another: only Pioneers are trained for."
        ),
    ] = DEFAULT_ROBOT,
    dock: Annotated[
        bool,
        typer.Option(
            "--dock", help="Train nothing: dock a mock with a camera at a place, by tags (docs/place.md)."
        ),
    ] = False,
    seed: Annotated[
        int | None,
        typer.Option(min=0, max=MAX_SEED, help="Root seed of the training.", show_default="0"),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for training, recording, picture and logs.")] = Path(
        "runs/park"
    ),
    overwrite: Overwrite = False,
    json: Json = False,
) -> int:
    """Train a circuit until it parks in simulation, then park a robot with it, all in one go.

    The robot is a mock Pioneer that speaks the real protocol over TCP, or, with --model, a mock ROS 2 robot
    on Zenoh; bridge and driver are the same processes that drive a real one, and talk over Zenoh. The true
    pose is judged, which the driver does not know. Ends with 0 parked, 1 not parked, or with the exit code of
    what failed.

    Training ends with the first agent that parks with half the tolerance to spare, or after 12. The
    folder has train/, run.mcap (with the true pose as truth/pose), run.html, trajectory.png and log/.

    With --dock, a localiser by tags is the fourth process, and the first approach is blocked on purpose.

        rover-ncp park --out runs/park
        rover-ncp park --dock --out runs/dock
    """
    if dock:
        from sim.park.dock import run_dock

        given = {"course": course, "model": model}
        odd = {name: value for name, value in given.items() if value not in {"parking", DEFAULT_ROBOT}}
        reject("does not go with --dock", policy=policy, seed=seed, **odd)
        return run_dock(Output(json), out, overwrite=overwrite)
    from sim.park.park import run_park

    return run_park(
        Output(json), policy=policy, course=course, model=model, seed=seed, out=out, overwrite=overwrite
    )
