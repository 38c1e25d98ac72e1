"""Commands of this package; heavy libraries load only when one runs."""

import signal
import socket
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.ros2.discovery import Convention
from rover_ncp.core.console import Json, Output, reject
from rover_ncp.core.errors import INTERRUPTED, UsageError

if TYPE_CHECKING:
    from bridge.bases import ChosenBase
    from bridge.gate.limits import Limits
    from bridge.inbox import Inbox


def bridge(
    *,
    base: Annotated[
        str | None,
        typer.Option(
            help="The base: tcp/HOST[:8101], serial//dev/ttyUSB0 (#baudrate=... if not 9600) or "
            "ros2/tcp/HOST[:7447], a ROS 2 robot's Zenoh router (#rmw=zenoh&domain=N for rmw_zenoh); or "
            "NAME/... of another installed base.",
            show_default="that of the robot's file",
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            help="The robot's file (YAML), whose keys count where no option is given.",
            show_default="without --base: robot.yaml in this folder",
        ),
    ] = None,
    listen: Annotated[
        str | None,
        typer.Option(
            help="Where drivers connect; port 0 takes a free one.", show_default="tcp/127.0.0.1:7447"
        ),
    ] = None,
    namespace: Annotated[str, typer.Option(help="Prefix of every key: bot1 makes bot1/odom.")] = "",
    model: Annotated[
        str | None,
        typer.Option(
            help="The robot's description, a name or a file; auto: the model that a Pioneer reports.",
            show_default="auto",
        ),
    ] = None,
    limits: Annotated[
        Path | None, typer.Option(help="YAML with v_max, omega_max, fence, sonar_stop_m ... of the gate.")
    ] = None,
    zenoh_config: Annotated[
        Path | None,
        typer.Option(help="Zenoh configuration for certificates and access control; see 'rover-ncp keys'."),
    ] = None,
    base_zenoh_config: Annotated[
        Path | None,
        typer.Option(
            help="Zenoh configuration (JSON5) of the session with a ROS 2 robot: TLS, user and password."
        ),
    ] = None,
    ros: Annotated[
        list[Convention] | None,
        typer.Option(
            help="Offer the topics to ROS 2 in this form, beside their plain keys; both may be given.",
            show_default="ros2dds",
        ),
    ] = None,
    insecure: Annotated[
        bool,
        typer.Option(
            "--insecure",
            help="Listen beyond this machine without authentication: every client that reaches it can drive.",
        ),
    ] = False,
    no_base_watchdog: Annotated[
        bool,
        typer.Option(
            "--no-base-watchdog",
            help="Let every driver drive a ROS 2 robot that is not known to halt when its commands stop: if "
            "this bridge dies, it may drive on.",
        ),
    ] = False,
    measure_timeout: Annotated[
        bool,
        typer.Option(
            "--measure-timeout",
            help="Serve no driver: measure when a ROS 2 robot halts after its last command, and print the "
            "line for robot.yaml. It drives forward at 0.1 m/s for up to 7 s: put it on blocks, or on "
            "the floor with 1 m free ahead if sensors under it forbid blocks.",
        ),
    ] = False,
    json: Json = False,
) -> int:
    """Connect a Pioneer or a ROS 2 robot to Zenoh: one driver at a time drives it, within limits.

    Without certificates it listens on this machine only, unless --insecure is given. A ROS 2 robot is
    driven only if its file or its description has the measured_base_timeout_s that --measure-timeout prints,
    or with --no-base-watchdog.

    Publishes odometry, transforms, battery, sonar, bumpers and diagnostics as ROS 2 messages, and passes
    commands on through a gate. Only the holder of the lease drives; the rover stops when no valid command
    arrives, and no command beyond the limits reaches it. Motors are off until a driver asks for them. It is
    ready when it prints "ready zenoh=... base=..."; Ctrl-C or SIGTERM stops the rover and ends it.

        rover-ncp bridge --base serial//dev/ttyUSB0 --limits limits.yaml
        rover-ncp bridge --measure-timeout
        rover-ncp bridge --base ros2/tcp/ROBOT --model turtlebot4 --listen tcp/127.0.0.1:7449
    """
    from bridge.base_messages import gate_status
    from bridge.bases import open_base
    from bridge.inbox import Inbox
    from bridge.node import BridgeResult, Node
    from bridge.options import BridgeSettings, settings_for
    from bridge.zenoh.link import ZenohLink
    from rover_ncp.core.bridge_lines import READY
    from rover_ncp.core.process import Interrupts

    if measure_timeout:
        reject(
            "does not go with --measure-timeout, which serves no driver",
            listen=listen,
            namespace=namespace,
            zenoh_config=zenoh_config,
            ros=ros,
            insecure=insecure,
            no_base_watchdog=no_base_watchdog,
        )
    given = BridgeSettings(
        base=base,
        listen=listen,
        namespace=namespace,
        model=model,
        limits=limits,
        zenoh_config=zenoh_config,
        base_zenoh_config=base_zenoh_config,
        no_base_watchdog=no_base_watchdog,
    )
    settings = settings_for(given, robot)
    chosen = settings.chosen()
    if not chosen.address.startswith("ros2/"):
        ros2_options = {"no_base_watchdog": no_base_watchdog, "measure_timeout": measure_timeout}
        reject("is for a ROS 2 robot (ros2/tcp/HOST)", **ros2_options)
    output, allowed, inbox = Output(json, controls=True), settings.gate_limits(chosen), Inbox()
    if measure_timeout:
        return _measure_timeout(chosen, inbox, allowed, output)
    with (
        Interrupts() as interrupts,
        ZenohLink(
            settings.listen,
            settings.namespace,
            settings.zenoh_config,
            inbox,
            insecure=insecure,
            ros=ros or [Convention.ROS2DDS],
        ) as link,
    ):
        driven, note = open_base(
            chosen,
            allowed,
            inbox,
            link,
            no_base_watchdog=settings.no_base_watchdog,
        )

        def ready() -> None:
            link.announce()
            if note:
                output.say(note)
            output.announce(f"{READY}zenoh={link.locator} base={chosen.address}")

        node = Node(driven, inbox.take, key=link.key, publish=link.publish, limits=allowed, ready=ready)
        node.run(lambda: interrupts.raised)
    status = gate_status(node.gate)
    result = BridgeResult(
        zenoh=link.locator,
        base=chosen.address,
        accepted=status.accepted,
        dropped=status.dropped,
        limited=status.limited,
        stops=status.stops,
        reconnects=max(node.reconnects, 0),
        flooded=inbox.flooded,
    )
    output.result(
        result,
        f"{status.accepted} commands passed, {sum(status.dropped.values())} dropped, "
        f"{sum(status.stops.values())} stops",
    )
    return INTERRUPTED if signal.SIGINT in interrupts.received else 0


def _measure_timeout(chosen: "ChosenBase", inbox: "Inbox", limits: "Limits", output: Output) -> int:
    from bridge.bases import open_ros2_base
    from bridge.measure_timeout import measure, words_for
    from rover_ncp.core.process import Interrupts, suspended_s

    with Interrupts() as interrupts:
        base, _ = open_ros2_base(chosen, inbox, unsafe=True)
        words = "the robot drives forward at 0.1 m/s for 1.5 s, then gets nothing until it halts"
        found = measure(
            *(base, inbox, limits, lambda: interrupts.raised),
            begins=lambda: output.say(words),
            clock=time,
            total_suspended_s=suspended_s,
        )
    output.result(found, words_for(found))
    return 0 if found.line else 1


def keys(
    *,
    out: Annotated[Path, typer.Option(help="Folder for the files; it must not hold keys already.")],
    host: Annotated[
        list[str] | None,
        typer.Option(
            help="DNS name or IP address of the bridge's machine, as drivers use it, without port; repeat "
            "for more. 127.0.0.1, localhost and this machine's name are included as well."
        ),
    ] = None,
    namespace: Annotated[str, typer.Option(help="The robot's namespace, such as bot1.")] = "",
    json: Json = False,
) -> None:
    """Make a certificate authority, and certificates for a bridge and its peers.

    Never replaces keys. Only their owner can read the files, except ca.pem.

    Writes one Zenoh configuration for each end, which holds all that end needs: bridge.json5
    for 'rover-ncp bridge --zenoh-config', driver.json5 for 'rover-ncp deploy --zenoh-config',
    viewer.json5 for users who may watch but not drive, localiser.json5 for a localisation system that may
    only publish the rover's pose and the picture of its camera. With them both ends prove their identity,
    all traffic is encrypted, and each role has only the rights that the table of keys grants. ca-key.pem
    signs certificates: keep it off the robot.

        rover-ncp keys --host 192.168.1.20 --out keys
    """
    from bridge.zenoh.certificate_authority import KeysResult, is_host, make_credentials
    from rover_ncp.core.files import require_writable, write_atomic

    taken = [name.name for name in out.glob("*") if name.suffix in {".pem", ".json5"}] if out.is_dir() else []
    if taken:
        names = ", ".join(sorted(taken))
        raise UsageError(f"--out {out}: holds keys already ({names}); choose another folder")
    require_writable(out / "ca.pem")
    hosts = list(
        dict.fromkeys([*(host or []), "127.0.0.1", "localhost", *filter(is_host, [socket.gethostname()])])
    )
    files = make_credentials(hosts, namespace)
    for name, content in files.items():
        write_atomic(out / name, content, private=name != "ca.pem")
    result = KeysResult(folder=str(out), files=sorted(files), hosts=hosts, namespace=namespace)
    Output(json).result(
        result,
        f"wrote {', '.join(sorted(files))} into {out}\n"
        f"the bridge may be called {', '.join(hosts)}\n"
        f"next, on the robot: rover-ncp bridge --base ... --zenoh-config {out}/bridge.json5\n"
        f"      at the desk:  rover-ncp deploy --robot tls/HOST --zenoh-config {out}/driver.json5",
    )
