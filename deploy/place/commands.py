"""The command ``place``; heavy libraries load only when it runs."""

import math
import time
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from deploy.options import Namespace, Robot, ZenohConfig, choose_robot
from rover_ncp.core.console import Json, Output, Overwrite, reject

if TYPE_CHECKING:
    from deploy.place.survey import Survey
    from deploy.zenoh_client import BridgeAddress


def place(
    what: Annotated[
        Literal["set", "check"],
        typer.Argument(help="set: store it. check: compare the present view with it."),
    ],
    name: Annotated[str, typer.Argument(help="The place: NAME or NAME.yaml.")],
    *,
    robot: Robot = None,
    seconds: Annotated[
        float, typer.Option(min=1.0, max=600.0, help="For how long poses are collected, s.")
    ] = 5.0,
    direction: Annotated[
        Literal["forward", "backward"] | None,
        typer.Option(help="set: how the rover drives in.", show_default="forward"),
    ] = None,
    overwrite: Overwrite = False,
    namespace: Namespace = "",
    zenoh_config: ZenohConfig = None,
    json: Json = False,
) -> int:
    """Store the place where the rover stands, or check one.

    set: drive the rover into the place with 'rover-ncp teleop' and let it stand. The median of the external
    poses on 'pose' becomes the place, with their scatter and their frame. Tolerances, proof, retries and
    obstacles are keys of the file. Set again, the place keeps these keys.

    check: let the rover stand in the place. It says how far the present view is from the stored place: a dock
    that was moved, a camera that was bent, a stale calibration.

        rover-ncp place set charger --robot tcp/192.168.1.20
        rover-ncp deploy --robot tcp/192.168.1.20 --to charger

    Ends with 0, with 1 if check finds the rover outside the place's tolerances or poses in another frame, or
    with 3 if there is no bridge or no pose.
    """
    from deploy.place.place import load_place, place_path
    from deploy.place.survey import PlaceResult, blurred, complaint, set_place
    from rover_ncp.core.config import dump_yaml
    from rover_ncp.core.files import require_writable, write_atomic

    chosen = choose_robot(robot, namespace, zenoh_config)
    path, checks = place_path(name, chosen.places), what == "check"
    if checks:
        reject("is for set", direction=direction, overwrite=overwrite)
    else:
        require_writable(path, overwrite=overwrite)
    stored = load_place(name, chosen.places) if checks or path.exists() else None
    seen = _look(chosen.address, seconds)
    pose, wrong = seen.pose, ""
    if stored is not None and checks:
        wrong = complaint(stored, seen)
        words = f"{stored.name}: {wrong or f'as stored, {stored.errors(pose)}'}"
    else:
        fields = stored.model_dump() if stored else {"name": path.stem}
        stored = set_place(fields | ({"direction": direction} if direction else {}), seen, str(path))
        write_atomic(path, dump_yaml(stored.model_dump(mode="json", exclude_none=True)))
        words = f"wrote {path}: x {pose.x:.3f} m, y {pose.y:.3f} m, {math.degrees(pose.theta):.1f}°"
    if warning := blurred(stored, seen.scatter):
        words += f"\n{warning}"
    result = PlaceResult(
        place=stored.name,
        file=str(path),
        frame=seen.frame,
        **pose._asdict(),
        scatter=seen.scatter,
        off=stored.errors(pose) if checks else None,
        fits=not wrong,
    )
    Output(json).result(result, words)
    return 1 if wrong else 0


def _look(address: "BridgeAddress", seconds: float) -> "Survey":
    """Collect the external poses of some seconds. Raises UnreachableError or KeyboardInterrupt."""
    from deploy.place.survey import survey
    from deploy.zenoh_client import ZenohClient
    from rover_ncp.core.errors import FormatError
    from rover_ncp.wire.key_table import KeySpec
    from rover_ncp.wire.messages import read_pose

    samples, unreadable = [], ""

    def receive(row: KeySpec, data: bytes) -> None:
        nonlocal unreadable
        if row.name != "pose":
            return
        try:
            samples.append(read_pose(data))
        except FormatError as error:
            unreadable = f"others cannot be read: {error}"

    with ZenohClient(address, receive):
        time.sleep(seconds)
    return survey(samples, seconds, unreadable)
