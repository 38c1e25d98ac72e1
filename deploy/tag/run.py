"""The commands ``tag run`` and ``tag calibrate``: camera, bridge, files."""

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from deploy.tag.calibrate import find_intrinsics, find_mount
from deploy.tag.camera import LiveCamera, Picture, pictures_of
from deploy.tag.detector import Detection, Detector
from deploy.tag.localiser import Localiser, TagCalibration, TagRunResult, drawn, tag_pose
from deploy.tag.pose_link import PoseLink
from deploy.tag.ros_camera import RosCamera, ros_camera_file
from deploy.tag.tag_map import CameraFile, Mount, TagMap, load_camera_info
from deploy.zenoh_client import BridgeAddress, ZenohClient
from rover_ncp.core.clock_offset import StampClock
from rover_ncp.core.config import dump_yaml, load_yaml
from rover_ncp.core.console import Output
from rover_ncp.core.errors import FormatError, UsageError
from rover_ncp.core.files import JPEG, begins_with, require_writable, write_atomic
from rover_ncp.core.geometry import Pose
from rover_ncp.core.interruption import INTERRUPTED
from rover_ncp.core.process import Interrupts
from rover_ncp.wire.address import ROS2
from rover_ncp.wire.key_table import KeySpec
from rover_ncp.wire.messages import pose_with_covariance, read_odometry

UNMEASURED = Mount(x=0.0, y=0.0, z=0.0)
"""What `calibrate` writes where a file has no mount yet."""
PICTURE_S = 1.0
"""Time between two pictures for people."""


def run_localiser(
    source: str,
    camera_file: Path | None,
    map_file: Path,
    *,
    address: BridgeAddress | None,
    decimate: float,
    seconds: float | None,
    picture: Path | None,
    output: Output,
) -> int:
    """See ``commands.run``; return the exit code."""
    tag_map = load_yaml(map_file, TagMap)
    if camera_file is not None:
        camera = _mounted(camera_file)
    elif source.startswith(ROS2):
        camera = ros_camera_file(source)
        output.say(f"by camera_info and tf_static: {camera.intrinsics}; mount {camera.mount}")
    else:
        raise UsageError("--camera-file: expected the camera's file; only a camera of ROS may do without it")
    if picture is not None:
        require_writable(picture, kind=begins_with("a picture (JPEG)", JPEG))
    localiser, shown = Localiser(camera, tag_map, decimate), 0.0
    with Interrupts() as interrupts, contextlib.ExitStack() as stack:
        link = stack.enter_context(PoseLink(address)) if address is not None else None
        began = time.monotonic()
        with opened(source, camera.delay_s) as (pictures, live), output.live(lambda: localiser.state):
            output.announce("localising")
            for each in until(pictures, seconds, lambda: interrupts.raised):
                found = localiser.take(each, time.time_ns() if live else None)
                if found is not None and link is not None:
                    link.send(pose_with_covariance(found.pose, found.covariance, each.wall_ns, tag_map.frame))
                if time.monotonic() - shown >= PICTURE_S:
                    shown, seen = time.monotonic(), (each.grey, localiser.detections, localiser.state)
                    if picture is not None:
                        write_atomic(picture, drawn(*seen))
                    if link is not None and link.watched:
                        link.show(drawn(*seen, small=True))
        result = TagRunResult(
            pictures=localiser.pictures,
            poses=localiser.poses,
            rejected=dict(localiser.rejected),
            unknown_ids=tuple(sorted(localiser.unknown)),
            seconds=time.monotonic() - began,
            last=tag_pose(localiser.last) if localiser.last else None,
        )
    lines = [f"{result.poses} poses from {result.pictures} pictures; last: {localiser.state}"]
    lines += [f"{count} without a pose: {reason}" for reason, count in result.rejected.items()]
    if result.unknown_ids:
        lines.append(f"tags that are not in the map: {', '.join(map(str, result.unknown_ids))}")
    output.result(result, "\n".join(lines))
    return INTERRUPTED if interrupts.raised else 0 if result.poses else 1


def calibrate_intrinsics(
    source: str, camera_file: Path, camera_info: Path | None, *, seconds: float, output: Output
) -> None:
    """Write a camera's intrinsics, from ROS's file or pictures of the board; keep a file's other keys."""
    require_writable(camera_file)
    known = load_yaml(camera_file, CameraFile) if camera_file.exists() else None
    if camera_info is not None:
        intrinsics, rms, used = load_camera_info(camera_info), None, 0
    else:
        found: list[list[Detection]] = []
        size, detector, last = (0, 0), Detector(), 0
        with Interrupts() as interrupts, opened(source) as (pictures, live):
            for each in until(pictures, seconds, lambda: interrupts.raised):
                if live and each.wall_ns - last < 0.5e9:  # neighbours show nothing new
                    continue
                last, before, size = each.wall_ns, size, (each.grey.shape[1], each.grey.shape[0])
                if found and size != before:
                    raise UsageError(
                        f"{source}: pictures of {before[0]} × {before[1]} and {size[0]} × {size[1]} pixels, "
                        "expected one size"
                    )
                found.append(detector.detect(each.grey))
                output.say(f"picture {len(found)}: {len(found[-1])} tags of the board")
        intrinsics, rms, used = find_intrinsics(found, size)
    camera = CameraFile(intrinsics=intrinsics, mount=UNMEASURED) if known is None else known
    camera = camera.model_copy(update={"intrinsics": intrinsics})
    _write(camera_file, camera)
    result = TagCalibration(out=str(camera_file), rms_px=rms, pictures=used, fx=intrinsics.fx)
    quality = "" if rms is None else f"; corners fit to {rms:.2f} px in {used} pictures"
    todo = "; its mount is all zero: measure it by hand" if camera.mount == UNMEASURED else ""
    output.result(result, f"wrote {camera_file}: focal length {intrinsics.fx:.1f} px{quality}{todo}")


def _mounted(camera_file: Path) -> CameraFile:
    """Load a camera's file whose mount was measured. Raises UsageError when it is still all zero."""
    camera = load_yaml(camera_file, CameraFile)
    if camera.mount == UNMEASURED:
        raise UsageError(
            f"{camera_file}: mount: all zero; measure x, y, z (m) and yaw, pitch, roll (rad) by hand"
        )
    return camera


def calibrate_mount(
    source: str, camera_file: Path, map_file: Path, *, address: BridgeAddress, seconds: float, output: Output
) -> None:
    """Improve the mount in a camera's file by a drive in which it sees tags."""
    camera, tag_map = _mounted(camera_file), load_yaml(map_file, TagMap)
    if tag_map.tags_on == "rover":
        raise UsageError(f"{map_file}: tags_on: rover: the mount of a ceiling's camera is measured by hand")
    require_writable(camera_file)
    odometry, detector = _Odometry(), Detector(2.0)  # as in `run`: the drive's processes need the processor
    seen: list[tuple[int, list[Detection]]] = []
    with (
        Interrupts() as interrupts,
        ZenohClient(address, odometry.take),
        opened(source, camera.delay_s) as (pictures, _),
    ):
        output.announce("collecting: drive and turn slowly, tags in view; Ctrl-C when done")
        for each in until(pictures, seconds, lambda: interrupts.raised):
            seen.append((each.wall_ns, detector.detect(each.grey)))
    if not odometry.samples:
        raise UsageError(
            f"no odometry arrived from the bridge at {address.robot}; with certificates, use a driver's: a "
            "localiser's may not read it"
        )
    found = find_mount(camera, tag_map, odometry.samples, seen)
    calibrated = found.applied(camera)
    _write(camera_file, calibrated)
    result = TagCalibration(
        out=str(camera_file),
        rms_px=found.rms,
        pictures=found.pictures,
        fx=camera.intrinsics.fx,
        mount=found.mount.model_dump(),
        deviations=found.deviations,
        late_s=found.late_s,
        delay_s=calibrated.delay_s,
    )
    std = found.deviations
    values = ", ".join(f"{name} {value:.4f} ± {std[name]:.4f}" for name, value in found.mount)
    output.result(
        result,
        f"wrote {camera_file}: {values} (m, rad); corners fit to {found.rms:.2f} px; pictures "
        f"{found.late_s:.3f} ± {std['late_s']:.3f} s later than delay_s said, now {calibrated.delay_s:.3f} s",
    )


class _Odometry:
    """Poses of the base with the moments of their measurement by this machine's wall clock, in ns."""

    def __init__(self) -> None:
        self._clock = StampClock()
        self.samples: list[tuple[int, Pose]] = []

    def take(self, row: KeySpec, data: bytes) -> None:
        """Take a message of the bridge; an unreadable one counts as none."""
        if row.name != "odom":
            return
        with contextlib.suppress(FormatError):
            sample, now_ns = read_odometry(data), time.monotonic_ns()
            measured_ns = self._clock.measured_ns(sample.stamp_ns, now_ns)
            if measured_ns is not None:
                self.samples.append((time.time_ns() - now_ns + measured_ns, sample.pose))


@contextlib.contextmanager
def opened(source: str, delay_s: float = 0.0) -> Iterator[tuple[Iterator[Picture], bool]]:
    """Open a source of pictures, and say whether it is a camera that runs."""
    pictures = RosCamera(source, delay_s) if source.startswith(ROS2) else pictures_of(source, delay_s)
    if isinstance(pictures, LiveCamera):
        with pictures:
            yield iter(pictures), True
    else:
        yield pictures, False


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
    write_atomic(path, dump_yaml(camera.model_dump(mode="json")))
