"""The command ``tag``: print tags, calibrate a camera, localise the rover by tags."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from deploy.options import Namespace, Robot, ZenohConfig, choose_robot
from rover_ncp.core.console import Json, Output, Overwrite, reject
from rover_ncp.core.errors import UsageError
from rover_ncp.wire.key_table import Role

if TYPE_CHECKING:
    from rover_ncp.robot.robot_file import RobotFile

tag = typer.Typer(
    name="tag",
    no_args_is_help=True,
    add_completion=False,
    help="Localise the rover by printed AprilTags: print them, calibrate a camera, send poses.\n\n"
    "The order is print, calibrate, run.\n\n"
    "    rover-ncp tag run --camera 0 --camera-file camera.yaml --map tags.yaml --robot tcp/127.0.0.1",
)

SOURCES = (
    "A device (0, /dev/video0; 'tag cameras' lists them), a stream or picture (http://...), a folder of "
    "pictures, or a ROS 2 topic (ros2/tcp/HOST#image=TOPIC)."
)
OF_FILE = "that of robot.yaml"
Camera = Annotated[str | None, typer.Option(help=SOURCES, show_default=OF_FILE)]
TAGS = "The tags: sizes and places (YAML), or the name of a board, such as board-17-a4"
Seconds = Annotated[
    float | None, typer.Option(min=0.1, help="End after so many seconds.", show_default=False)
]


@tag.command("print")
def print_tags(
    *,
    ids: Annotated[str, typer.Option(help="Ids of the tags, such as 0-3,7.")] = "0,1",
    size: Annotated[float, typer.Option(min=0.01, max=0.4, help="Edge of the black square, m.")] = 0.14,
    board: Annotated[
        bool, typer.Option("--board", help="Print a board instead: one page of tags for a place.")
    ] = False,
    number: Annotated[
        int | None,
        typer.Option(min=1, help="With --board: which of the boards.", show_default="at random"),
    ] = None,
    page: Annotated[Literal["a4", "a3", "letter"], typer.Option(help="The paper.")] = "a4",
    out: Annotated[
        Path | None,
        typer.Option(help="The PDF to write.", show_default="tags.pdf, or the board's name"),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write tags to print, as a PDF true to size: one on each page, with a ruler; or a board.

    Print without scaling and measure the ruler. Glue the sheets to something flat. A board's tags have known
    places on their page, so that nothing is measured, and its name is for --map. Boards of two numbers cannot
    be confused; two prints of one board can.

        rover-ncp tag print --board
        rover-ncp tag print --ids 0,1 --size 0.14 --out tags.pdf
    """
    import secrets

    from deploy.tag.board import NUMBERS, board_map
    from deploy.tag.localiser import TagPrintResult
    from deploy.tag.sheet import board_page, tag_pages
    from rover_ncp.core.files import require_writable, write_atomic

    if not board:
        reject("needs --board", number=number)
    chosen = secrets.choice(NUMBERS) if number is None else number
    if chosen not in NUMBERS:
        raise UsageError(f"--number {chosen}: expected 1 to {NUMBERS[-1]}")
    name = board_map(chosen, page).frame if board else None
    out = Path(f"{name or 'tags'}.pdf") if out is None else out
    if out.suffix.lower() != ".pdf":
        raise UsageError(f"--out {out}: expected a .pdf")
    require_writable(out, overwrite=overwrite)
    numbers = [tag.id for tag in board_map(chosen, page).tags] if board else parse_ids(ids)
    write_atomic(out, board_page(chosen, page) if board else tag_pages(numbers, size, page))
    result = TagPrintResult(
        out=str(out), ids=tuple(numbers), size=None if board else size, page=page, board=name
    )
    words = f"wrote {out}: print it at 100 % and measure its ruler"
    Output(json).result(result, f"{words}, then 'tag run --map {name}'" if board else words)


@tag.command()
def calibrate(
    *,
    camera: Camera = None,
    camera_file: Annotated[
        Path | None,
        typer.Option(help="The camera's file to write, or to improve.", show_default=OF_FILE),
    ] = None,
    camera_info: Annotated[
        Path | None, typer.Option(help="Take the intrinsics from a YAML file of ROS or OpenCV.")
    ] = None,
    map: Annotated[
        Path | None, typer.Option(help="Measure the yaw of the mount: the tags (YAML), or a board's name.")
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            help="Size of a device's pictures, such as 1280x720.", show_default="the file's, or the device's"
        ),
    ] = None,
    seconds: Annotated[
        float, typer.Option(min=1.0, max=600.0, help="How long to look, unless Ctrl-C ends it.")
    ] = 60.0,
    json: Json = False,
) -> None:
    """Calibrate a camera. Without --map: its intrinsics. With --map: the yaw of its mount on the rover.

    Intrinsics: show the camera a board of 'tag print --board', near and far and tilted, or take pictures of
    it into a folder. The new file has the camera at the base's origin: write its measured place and angles
    into it. Yaw: drive about 1 m straight ahead with 'rover-ncp teleop', tags in view.

        rover-ncp tag calibrate --camera pictures/ --camera-file camera.yaml
        rover-ncp tag calibrate --map board-17-a4
    """
    from deploy.tag.run import calibrate_intrinsics, calibrate_yaw
    from rover_ncp.robot.robot_file import find_robot_file

    output, pixels = Output(json), None if size is None else parse_size(size)
    if camera is None or camera_file is None:
        camera, camera_file = _camera(find_robot_file(None), camera, camera_file)
    if camera is None or camera_file is None:
        raise UsageError(
            "--camera and --camera-file are missing, and so is robot.yaml, which would name both"
        )
    if map is None:
        calibrate_intrinsics(camera, camera_file, camera_info, size=pixels, seconds=seconds, output=output)
    elif camera_info is not None or size is not None:
        raise UsageError("--camera-info and --size are for the intrinsics, without --map")
    else:
        calibrate_yaw(camera, camera_file, map, seconds=seconds, output=output)


@tag.command()
def run(
    *,
    camera: Camera = None,
    map: Annotated[Path | None, typer.Option(help=f"{TAGS}.", show_default=OF_FILE)] = None,
    camera_file: Annotated[
        Path | None,
        typer.Option(
            help="The camera's file (YAML), as 'tag calibrate' writes it.",
            show_default="the robot's file, or of a ROS 2 camera: by camera_info and tf_static",
        ),
    ] = None,
    robot: Robot = None,
    seconds: Seconds = None,
    picture: Annotated[
        Path | None,
        typer.Option(help="Write the newest picture, its tags outlined, to this JPEG once a second."),
    ] = None,
    overwrite: Overwrite = False,
    namespace: Namespace = "",
    zenoh_config: ZenohConfig = None,
    json: Json = False,
) -> int:
    """Send the pose of the base, from the tags that a camera sees, on the key 'pose'.

    The camera is on the rover and the tags on walls, or the camera on the ceiling and tags on the rover; the
    map says which. A picture gives a pose only if all its tags fit. Others are counted by reason: no tag, a
    tag that does not fit, two poses that fit, a frozen, dark or over-exposed picture. Without --robot and
    robot.yaml poses are only shown. Ready when it prints "localising". Ends at Ctrl-C with 130; after
    --seconds or the last picture with 0, or 1 if no picture gave a pose.

        rover-ncp tag run
        rover-ncp tag run --camera 0 --camera-file camera.yaml --map tags.yaml --robot tcp/127.0.0.1
    """
    from deploy.tag.run import run_localiser
    from rover_ncp.robot.robot_file import find_robot_file

    if picture is None:
        reject("needs --picture", overwrite=overwrite)
    address, file = None, find_robot_file(robot)
    if robot is not None or file is not None:
        address = choose_robot(robot, namespace, zenoh_config, role=Role.LOCALISER).address
    if file is not None and camera is None:
        if picture is None and file.picture is not None:
            picture, overwrite = file.picture, True
        camera, camera_file = _camera(file, camera, camera_file)
    if file is not None and map is None:
        file.need("tags", "'tag run' needs it, or --map")
        map = file.tags
    if camera is None or map is None:
        raise UsageError("--camera and --map are missing, and so is robot.yaml, which would name both")
    return run_localiser(
        camera,
        camera_file,
        map,
        address=address,
        seconds=seconds,
        picture=picture,
        overwrite=overwrite,
        output=Output(json, controls=True),
    )


@tag.command()
def cameras(*, json: Json = False) -> int:
    """List the cameras of this machine (Linux), for --camera.

    Each with its path, its name, and a path that it keeps when other cameras are plugged in. Ends with 1 if
    there is none.

        rover-ncp tag cameras
    """
    from deploy.tag.run import list_cameras

    return list_cameras(Output(json))


def _camera(
    file: "RobotFile | None", camera: str | None, camera_file: Path | None
) -> tuple[str | None, Path | None]:
    """Return a camera and its file; what is not given is that of the robot's file. Raises ConfigError."""
    if file is None:
        return camera, camera_file
    settings = file.need("camera", "here, or as --camera and --camera-file")
    return camera or file.camera, camera_file or file.place_of(settings.file)


def parse_ids(text: str) -> list[int]:
    """Return the numbers of ``0-3,7``. Raises UsageError."""
    from deploy.tag.tag_map import IDS

    numbers: list[int] = []
    for part in text.split(","):
        if not re.fullmatch(r"\d{1,4}(-\d{1,4})?", part.strip()):
            raise UsageError(f"--ids {text}: expected numbers and ranges, such as 0-3,7")
        first, _, last = part.strip().partition("-")
        numbers += range(int(first), int(last or first) + 1)
    if not numbers or max(numbers) >= IDS:
        raise UsageError(f"--ids {text}: expected numbers from 0 to {IDS - 1}")
    return numbers


def parse_size(text: str) -> tuple[int, int]:
    """Return width and height of ``1280x720``. Raises UsageError."""
    found = re.fullmatch(r"(\d{2,5})[x×](\d{2,5})", text.strip().lower())
    if found is None:
        raise UsageError(f"--size {text}: expected width and height, such as 1280x720")
    return int(found[1]), int(found[2])
