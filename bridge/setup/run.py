"""The command ``setup``: its questions in order, and what they lead to."""

import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import Field

from bridge.setup.dialog import Dialog
from bridge.setup.find import RosRobot, cameras, pioneer_at, ros_robots_at, serial_ports
from rover_ncp.core.bridge_lines import READY
from rover_ncp.core.child import Child, ParentPipe
from rover_ncp.core.config import ResultModel, validated
from rover_ncp.core.console import Output, print_line
from rover_ncp.core.errors import NoRobot, UsageError
from rover_ncp.core.files import require_writable, shipped_names, write_atomic
from rover_ncp.core.process import Interrupts
from rover_ncp.robot.description import RobotDescription, load_description
from rover_ncp.robot.robot_file import RobotSettings, commented, load_robot_file
from rover_ncp.wire.address import ROS2, parse_address
from rover_ncp.wire.probe import Listener, listener_at
from rover_ncp.wire.zenoh import PORT

READY_S = 60.0


class SetupResult(ResultModel):
    """Result of the command ``setup``."""

    file: str = Field(description="the robot's file that was written")
    measured_base_timeout_s: float | None = Field(description="as the file has it now")
    check: bool | None = Field(description="whether the check said yes; null if it was not run")


def run(path: Path, output: Output, *, overwrite: bool, terminal: bool) -> int:
    """See ``commands.setup``; return the exit code."""
    known = load_robot_file(path).settings.model_dump(exclude_unset=True) if path.exists() else {}
    if not terminal:
        lacks = ", ".join(_missing(known)) or "nothing that docking needs"
        raise UsageError(
            f"setup asks questions and needs a terminal; {path} lacks {lacks}. 'rover-ncp setup --print' "
            "prints the file to fill in"
        )
    require_writable(path, overwrite=overwrite)
    dialog = Dialog(_ask, partial(print_line, sys.stderr if output.as_json else sys.stdout))
    robot, images = _robot(dialog, known)
    chosen = known | robot
    chosen |= _localiser(dialog, path, images, known)
    keys = dialog.text(
        "Folder with certificates, if other machines shall drive or watch",
        "Without certificates only this machine reaches the robot; 'rover-ncp keys --out keys' makes them.",
        known.get("keys"),
    )
    chosen = {name: value for name, value in (chosen | {"keys": keys}).items() if value is not None}
    settings = _write(path, chosen)
    output.say(f"wrote {path}")
    camera = settings.camera
    if camera is not None and camera.file is not None and not (path.parent / camera.file).exists():
        output.say(f"{camera.file} is missing: 'rover-ncp tag calibrate' writes it (docs/tags)")
    drives_on = False
    if chosen["base"].startswith(ROS2):
        measured = _measure(dialog, path)
        if measured is not None:  # what was known before does not count
            chosen.pop("measured_base_timeout_s", None)
            found = {} if math.isinf(measured) else {"measured_base_timeout_s": measured}
            settings = _write(path, chosen | found)
            drives_on = math.isinf(measured)
            if drives_on and _described_timeout(path) is not None:
                dialog.say(f"  {settings.model} has a measured_base_timeout_s, which is wrong: take it out")
    ready = _check(dialog, path)
    result = SetupResult(
        file=str(path), measured_base_timeout_s=settings.measured_base_timeout_s, check=ready
    )
    timed = settings.measured_base_timeout_s is not None or _described_timeout(path) is not None
    if chosen["base"].startswith(ROS2) and not settings.no_base_watchdog and (drives_on or not timed):
        unchecked = "no driver may drive the robot unless it is measured that it halts by itself"
    else:
        unchecked = "not checked; next: rover-ncp up"
    words = {True: "is ready; next: rover-ncp up", False: "see above", None: unchecked}
    output.result(result, f"{path}: {words[ready]}")
    return 1 if ready is False else 0


def _ask(prompt: str) -> str:
    try:
        return input(prompt)
    except EOFError as error:
        raise KeyboardInterrupt from error


def _missing(known: dict[str, Any]) -> list[str]:
    wanted = ["base", "camera", "tags"]
    if known.get("base", "").startswith(ROS2):
        wanted += ["measured_base_timeout_s"]
    return [name for name in wanted if known.get(name) is None]


def _write(path: Path, chosen: dict[str, Any]) -> RobotSettings:
    settings = validated(chosen, RobotSettings, str(path))
    write_atomic(path, commented(settings))
    return settings


def _robot(dialog: Dialog, known: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return base and model, and the cameras of a ROS 2 robot."""
    found = [f"serial/{each}" for each in _pioneers(dialog)]
    robots = {each.address: each for each in _ros_robots(dialog, known.get("base"))}
    base = None
    while base is None:
        base = dialog.choice(
            "Which robot?",
            "The bridge connects to it: these were found, or give an address: tcp/HOST:8101 of a Pioneer, "
            "serial//dev/ttyUSB0, ros2/tcp/HOST.",
            [*robots, *found],
            "an address",
            known.get("base"),
        )
    chosen: dict[str, Any] = {"base": base}
    if base != known.get("base"):  # what was measured and allowed was another robot's
        chosen |= {"measured_base_timeout_s": None, "no_base_watchdog": None}
    images = list[str]()
    if base.startswith(ROS2):
        robot = robots.get(base, RosRobot(base, "turtlebot4", ()))
        mark = "&" if "#" in base else "#"
        images = [f"{base}{mark}image={topic}" for topic in robot.images]
        chosen["model"] = dialog.choice(
            "Which model?",
            "Its description has topics, size and speeds. Another robot needs a file (docs/own_ros2_robot).",
            [name for name in shipped_names("robots") if not name.startswith("p3")],
            "a file",
            known.get("model") or robot.model,
        )
    return chosen, images


def _pioneers(dialog: Dialog) -> list[str]:
    """Return the serial ports on which a Pioneer answers; each is asked only with permission."""
    found = []
    for port in serial_ports():
        question = f"Look for a Pioneer at {port.path} ({port.name})?"
        why = "It sends the first bytes of a connection there. Another device could misread them."
        if not dialog.yes(question, why):
            continue
        try:
            dialog.say(f"  answers: {pioneer_at(f'serial/{port.path}')}")
            found.append(port.path)
        except NoRobot as error:
            dialog.say(f"  no Pioneer: {error}")
    return found


def _ros_robots(dialog: Dialog, base: str | None) -> list[RosRobot]:
    """Return the ROS 2 robots behind the Zenoh router that a person names."""
    own = f"tcp/127.0.0.1:{PORT}"
    default = "127.0.0.1" if listener_at(own) is not Listener.NOTHING else None
    if base is not None and base.startswith(ROS2):
        default = base.removeprefix(f"{ROS2}tcp/").partition("#")[0]
    host = dialog.text(
        "Host of a ROS 2 robot's Zenoh router (HOST or HOST:PORT)",
        "Its topics are listed there; nothing is sent to the robot. Leave it for a Pioneer.",
        default,
    )
    address = None if host is None else parse_address(f"tcp/{host}", PORT)
    if address is None:
        return []
    try:
        robots = ros_robots_at(str(address))
    except NoRobot as error:
        dialog.say(f"  {error}")
        return []
    dialog.say(f"  found: {', '.join(each.address for each in robots) or 'no odometry is announced there'}")
    return robots


def _localiser(dialog: Dialog, path: Path, images: list[str], known: dict[str, Any]) -> dict[str, Any]:
    """Return camera and tags; ``images`` are cameras of the robot."""
    earlier = known.get("camera") or {}
    found = dict.fromkeys(images, "of the robot")
    found |= {each.path: each.name for each in cameras(lambda words: dialog.say(f"  {words}"))}
    source = dialog.choice(
        "Which camera sees the tags?",
        "Docking needs the poses that it gives. "
        + (", ".join(f"{path}: {name}" for path, name in found.items()) or "None was found."),
        list(found),
        "http://... or ros2/tcp/HOST#image=TOPIC",
        earlier.get("source"),
    )
    if source is None:
        return {"camera": None, "tags": None}
    file = dialog.text(
        "File with the camera's calibration",
        "'rover-ncp tag calibrate' writes it. A ROS 2 camera has its own: leave none there.",
        earlier.get("file") or (None if source.startswith(ROS2) else "camera.yaml"),
    )
    camera = {**earlier, "source": source, "file": file}
    camera = {name: value for name, value in camera.items() if value is not None}
    return {"camera": camera, "tags": _tags(dialog, path, known)}


def _tags(dialog: Dialog, path: Path, known: dict[str, Any]) -> str | None:
    """Return the board or the file of the tags; print a board if there is none."""
    folder = path.parent
    boards = [each.stem for each in sorted(folder.glob("board-*.pdf"))]
    default = known.get("tags") or ("tags.yaml" if (folder / "tags.yaml").exists() else None)
    default = default or (boards[0] if boards else None)
    if default is None and dialog.yes(
        "Write a board of tags to print?",
        "One page that hangs at the place; nothing is surveyed. Say no if tags hang there already.",
        default=True,
    ):
        _, printed = _run("tag", "print", "--board", "--json", folder=folder)
        default = printed.get("board")
        if default is not None:
            dialog.say(f"  wrote {folder / printed['out']}: print it at 100 % and measure its ruler")
    return dialog.text(
        "Board or file of the tags",
        "A board has a name (board-17-a4); a file has the places of single tags.",
        default,
    )


def _needs_floor(path: Path) -> bool:
    """Return whether the robot is tested on the floor, by its description."""
    described = _described(path)
    return described is not None and described.tested_on == "floor"


def _described_timeout(path: Path) -> float | None:
    """Return the measured base timeout in the description of the robot's model."""
    described = _described(path)
    return None if described is None else described.measured_base_timeout_s


def _described(path: Path) -> RobotDescription | None:
    model = load_robot_file(path).model
    return None if model is None else load_description(model)


def _measure(dialog: Dialog, path: Path) -> float | None:
    """Return the base timeout of a ROS 2 robot: infinite if it drives on, None if it was not measured."""
    where = "on the floor, with 1 m free ahead" if _needs_floor(path) else "on blocks, its wheels free"
    question = f"Measure when the robot halts by itself? Put it {where}: it drives at 0.1 m/s for up to 7 s"
    if not dialog.yes(
        question, "If the bridge dies, only that stops the robot: without it nothing drives it."
    ):
        return None
    _, answer = _run("bridge", "--measure-timeout", "--robot", str(path), "--json")
    if "line" not in answer:
        dialog.say(f"  not measured: {answer.get('error', 'see above')}")
        return None
    drove_on = f"it does not halt by itself in time, so {path} has no measured_base_timeout_s"
    if not answer["line"]:
        dialog.say(f"  {drove_on}")
        return math.inf
    if not dialog.yes(
        f"It halted after {answer['timeout_s']:g} s by its odometry. Did its wheels stand then, too?",
        "Odometry that freezes when the commands stop looks the same.",
    ):
        dialog.say(f"  {drove_on}")
        return math.inf
    return float(answer["timeout_s"])


def _check(dialog: Dialog, path: Path) -> bool | None:
    """Run the check with a bridge of its own; return whether it said yes, None if it was not run."""
    floor = _needs_floor(path)
    where = "on the floor, with 2 m free ahead and 0.5 m to each side" if floor else "on blocks"
    if not dialog.yes(
        f"Check the robot now? Put it {where}: it turns its wheels",
        "It compares all sensors with odometry, and names the first thing that is wrong.",
    ):
        return None
    log = path.parent / "logs" / "setup.log"
    log.parent.mkdir(exist_ok=True)
    with Interrupts() as interrupts, ParentPipe() as pipe:
        bridge = Child(["bridge", "--robot", str(path)], log, pipe)
        deadline_s = time.monotonic() + READY_S
        lines = list[str]()
        while not any(line.startswith(READY) for line in lines):
            if bridge.code is not None or interrupts.raised or time.monotonic() > deadline_s:
                break
            lines += bridge.new_lines()
            time.sleep(0.05)
        else:
            code, _ = _run("check", "--robot", str(path), "--on-floor" if floor else "--on-blocks")
            bridge.send(signal.SIGTERM)
            bridge.wait(10.0)
            return code == 0
        bridge.send(signal.SIGTERM)
        bridge.wait(10.0)
    if interrupts.raised:
        raise KeyboardInterrupt
    bridge.new_lines()
    dialog.say(f"  not checked: the bridge {bridge.end}")
    return False


def _run(*arguments: str, folder: Path | None = None) -> tuple[int, dict[str, Any]]:
    """Run a command in this terminal, which gets Ctrl-C itself; return its code and its JSON.

    ``folder`` is its working folder.
    """
    piped = subprocess.PIPE if "--json" in arguments else None
    with Interrupts() as interrupts:
        command: Sequence[str] = [sys.executable, "-P", "-m", "rover_ncp", *arguments]
        with subprocess.Popen(command, stdout=piped, text=True, cwd=folder) as child:
            printed = child.stdout.read() if child.stdout else ""
            code = child.wait()
    if interrupts.raised:
        raise KeyboardInterrupt
    try:
        return code, json.loads(printed)
    except ValueError:
        return code, {}
