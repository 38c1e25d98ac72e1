"""The commands ``tag run`` and ``tag calibrate``: camera, bridge, files."""

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

from deploy.tag.board import load_tags
from deploy.tag.calibrate import find_intrinsics, find_yaw
from deploy.tag.cameras.camera import (
    DeviceCamera,
    DeviceSettings,
    LiveCamera,
    Picture,
    devices,
    folder_pictures,
    is_device,
)
from deploy.tag.cameras.camera_info import load_camera_info
from deploy.tag.cameras.http_camera import HttpCamera
from deploy.tag.cameras.ros_camera import RosCamera, ros_camera_file
from deploy.tag.detector import Detection, Detector
from deploy.tag.localiser import (
    DECIMATE,
    Localiser,
    TagCalibration,
    TagCameras,
    TagRunResult,
    tag_pose,
)
from deploy.tag.pose_link import PoseLink
from deploy.tag.tag_map import CameraFile, Mount
from deploy.tag.view import View
from deploy.tag.view_file import ViewFile
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.config import dump_yaml, load_yaml
from rover_ncp.core.console import Output
from rover_ncp.core.errors import INTERRUPTED, UsageError
from rover_ncp.core.files import require_writable, write_atomic
from rover_ncp.core.process import Interrupts
from rover_ncp.wire.address import ROS2
from rover_ncp.wire.messages import pose_with_covariance

UNMEASURED = Mount(x=0.0, y=0.0, z=0.0)
"""What `calibrate` writes where a file has no mount yet."""
VIEW_S = 0.5
"""Time between two pictures for people."""
FILE_EVERY = 2
"""The file gets one of so many."""


def run_localiser(
    source: str,
    camera_file: Path | None,
    map_file: Path,
    *,
    address: BridgeAddress | None,
    seconds: float | None,
    picture: Path | None,
    overwrite: bool,
    output: Output,
) -> int:
    """See ``commands.run``; return the exit code."""
    tag_map = load_tags(map_file)
    if camera_file is not None:
        camera = _mounted(camera_file)
    elif source.startswith(ROS2):
        camera = ros_camera_file(source)
        output.say(f"by camera_info and tf_static: {camera.intrinsics}; mount {camera.mount}")
    else:
        raise UsageError("--camera-file: expected the camera's file; only a camera of ROS may do without it")
    if picture is not None:
        require_writable(picture, overwrite=overwrite)
    localiser, views, view_s = Localiser(camera, tag_map), 0, 0.0
    with Interrupts() as interrupts, contextlib.ExitStack() as stack:
        link = stack.enter_context(PoseLink(address, tag_map.frame)) if address is not None else None
        file = stack.enter_context(ViewFile(picture, output.say)) if picture is not None else None
        began = time.monotonic()
        settings, left_out = device_settings(camera), localiser.rejected
        with opened(source, settings, left_out) as (pictures, live), output.live(lambda: localiser.state):
            output.announce("localising")
            for each in until(pictures, seconds, lambda: interrupts.raised):
                found = localiser.take(each, time.time_ns() if live else None)
                if found is not None and link is not None:
                    link.send(pose_with_covariance(found.pose, found.covariance, each.wall_ns, tag_map.frame))
                if (now_s := time.monotonic()) >= view_s:
                    views, view_s = views + 1, max(view_s + VIEW_S, now_s)
                    view = View(each.grey, localiser.detections, localiser.state, each.wall_ns)
                    if link is not None and link.watched:
                        link.show(view.messages())
                    if file is not None and views % FILE_EVERY == 1:
                        file.show(view)
        result = TagRunResult(
            pictures=localiser.pictures,
            poses=localiser.poses,
            rejected=dict(localiser.rejected),
            unknown_ids=tuple(sorted(localiser.unknown)),
            twice_ids=tuple(sorted(localiser.twice)),
            seconds=time.monotonic() - began,
            last=tag_pose(localiser.last) if localiser.last else None,
        )
    lines = [f"{result.poses} poses from {result.pictures} pictures; last: {localiser.state}"]
    lines += [f"{count} without a pose: {reason}" for reason, count in result.rejected.items()]
    if result.unknown_ids:
        lines.append(f"tags that are not in the map: {', '.join(map(str, result.unknown_ids))}")
    if result.twice_ids:
        lines.append(f"tags that are printed twice: {', '.join(map(str, result.twice_ids))}")
    output.result(result, "\n".join(lines))
    return INTERRUPTED if interrupts.raised else 0 if result.poses else 1


def calibrate_intrinsics(
    source: str,
    camera_file: Path,
    camera_info: Path | None,
    *,
    size: tuple[int, int] | None,
    seconds: float,
    output: Output,
) -> None:
    """Write a camera's intrinsics, from another program's file or pictures of the board; keep other keys."""
    require_writable(camera_file, overwrite=True)
    known = load_yaml(camera_file, CameraFile) if camera_file.exists() else None
    if camera_info is not None:
        intrinsics, rms, used, fx_std = load_camera_info(camera_info), None, 0, None
    else:
        settings = DeviceSettings() if known is None else device_settings(known)
        settings = settings if size is None else settings._replace(size=size)
        found, taken, last = list[list[Detection]](), (0, 0), 0
        detector, left_out = Detector(), Counter[str]()
        with Interrupts() as interrupts, opened(source, settings, left_out) as (pictures, live):
            for each in until(pictures, seconds, lambda: interrupts.raised):
                if live and each.wall_ns - last < 0.5e9:  # neighbours show nothing new
                    continue
                last, before, taken = each.wall_ns, taken, (each.grey.shape[1], each.grey.shape[0])
                if found and taken != before:
                    raise UsageError(
                        f"{source}: pictures of {before[0]} × {before[1]} and {taken[0]} × {taken[1]} "
                        "pixels, expected one size"
                    )
                found.append(detector.detect(each.grey))
                output.say(f"picture {len(found)}: {len(found[-1])} tags of the board")
        intrinsics, rms, used, fx_std = find_intrinsics(found, taken)
    camera = CameraFile(intrinsics=intrinsics, mount=UNMEASURED) if known is None else known
    camera = camera.model_copy(update={"intrinsics": intrinsics})
    _write(camera_file, camera)
    result = TagCalibration(out=str(camera_file), rms_px=rms, pictures=used, fx=intrinsics.fx, fx_std=fx_std)
    measured = rms is not None
    quality = f" ± {fx_std:.1f} px; corners fit to {rms:.2f} px in {used} pictures" if measured else " px"
    todo = "; its mount is all zero: measure it by hand" if camera.mount == UNMEASURED else ""
    output.result(result, f"wrote {camera_file}: focal length {intrinsics.fx:.1f}{quality}{todo}")


def _mounted(camera_file: Path) -> CameraFile:
    """Load a camera's file whose mount was measured. Raises UsageError when it is still all zero."""
    camera = load_yaml(camera_file, CameraFile)
    if camera.mount == UNMEASURED:
        raise UsageError(
            f"{camera_file}: mount: all zero; measure x, y, z (m) and yaw, pitch, roll (rad) by hand"
        )
    return camera


def calibrate_yaw(source: str, camera_file: Path, map_file: Path, *, seconds: float, output: Output) -> None:
    """Measure the yaw of the mount in a camera's file by a straight drive in which it sees tags."""
    camera, tag_map = _mounted(camera_file), load_tags(map_file)
    if tag_map.tags_on == "rover":
        raise UsageError(f"{map_file}: tags_on: rover: the mount of a ceiling's camera is measured by hand")
    require_writable(camera_file, overwrite=True)
    detector, left_out = Detector(DECIMATE), Counter[str]()
    seen: list[list[Detection]] = []
    with (
        Interrupts() as interrupts,
        opened(source, device_settings(camera), left_out) as (pictures, _),
    ):
        output.announce("collecting: drive about 1 m straight ahead, slowly, tags in view; Ctrl-C when done")
        for each in until(pictures, seconds, lambda: interrupts.raised):
            camera.intrinsics.require_size(each.grey)
            seen.append(detector.detect(each.grey))
    found = find_yaw(camera, tag_map, seen)
    mount = camera.mount.model_copy(update={"yaw": round(found.yaw, 5)})
    _write(camera_file, camera.model_copy(update={"mount": mount}))
    result = TagCalibration(
        out=str(camera_file),
        rms_px=None,
        pictures=found.pictures,
        fx=camera.intrinsics.fx,
        yaw=mount.yaw,
        yaw_std=found.deviation,
    )
    output.result(
        result,
        f"wrote {camera_file}: yaw {mount.yaw:.4f} ± {found.deviation:.4f} rad, before it was "
        f"{camera.mount.yaw:.4f}; {found.pictures} pictures on {found.distance:.2f} m",
    )


def list_cameras(output: Output) -> int:
    """See ``commands.cameras``; return the exit code."""
    found = devices()
    lines = [f"{each.path}  {each.name}" + (f"  ({each.stable})" if each.stable else "") for each in found]
    result = TagCameras(cameras=tuple(found))
    output.result(result, "\n".join(lines) or "no camera: is it plugged in, and passed to this container?")
    return 0 if found else 1


def device_settings(camera: CameraFile) -> DeviceSettings:
    """Return what a device is set to for a camera's calibration to be right."""
    return DeviceSettings((camera.intrinsics.width, camera.intrinsics.height), camera.rate_hz, camera.focus)


@contextlib.contextmanager
def opened(
    source: str, settings: DeviceSettings, left_out: Counter[str]
) -> Iterator[tuple[Iterator[Picture], bool]]:
    """Open a source of pictures, and say whether it is a camera that runs.

    Pictures that cannot be read are counted in ``left_out``. Raises UsageError and FileError.
    """
    camera: LiveCamera
    if source.startswith(ROS2):
        camera = RosCamera(source, left_out)
    elif "://" in source:
        camera = HttpCamera(source, left_out)
    elif is_device(source):
        camera = DeviceCamera(source, settings, left_out)
    else:
        yield folder_pictures(source, left_out), False
        return
    with camera:
        yield iter(camera), True


def until(
    pictures: Iterator[Picture], seconds: float | None, stopping: Callable[[], bool]
) -> Iterator[Picture]:
    """Yield pictures until ``seconds`` are over or ``stopping()``."""
    began = time.monotonic()
    for each in pictures:
        if stopping():
            return
        yield each
        if seconds is not None and time.monotonic() - began >= seconds:
            return


def _write(path: Path, camera: CameraFile) -> None:
    write_atomic(path, dump_yaml(camera.model_dump(mode="json", exclude_none=True)))
