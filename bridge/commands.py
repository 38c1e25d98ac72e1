"""Commands of this package; heavy libraries load only when one runs."""

from pathlib import Path
from typing import Annotated

import typer

from bridge.ros.discovery import Convention
from rover_ncp.core.console import Json, reject
from rover_ncp.core.files import USUAL_ROBOT


def bridge(
    *,
    base: Annotated[
        str,
        typer.Option(
            help="The robot: tcp/HOST[:8101], serial//dev/ttyUSB0 (#baudrate=... is the rate tried first) or "
            "ros2/tcp/HOST[:7447], a ROS 2 robot's Zenoh router (#rmw=zenoh&domain=N for rmw_zenoh, "
            "&odom=TOPIC for topics of its own); or NAME/... of an installed base driver."
        ),
    ],
    listen: Annotated[
        str | None,
        typer.Option(
            help="Where drivers connect; port 0 takes a free one.", show_default="tcp/127.0.0.1:7447"
        ),
    ] = None,
    namespace: Annotated[str, typer.Option(help="Prefix of every key: bot1 makes bot1/odom.")] = "",
    model: Annotated[
        str,
        typer.Option(
            help="The robot's description, a name or a file; auto: the model that a Pioneer reports."
        ),
    ] = "auto",
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
    accept_ros: Annotated[
        bool, typer.Option("--accept-ros", help="Also accept plain ROS cmd_vel (Twist, TwistStamped).")
    ] = False,
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
    json: Json = False,
) -> int | None:
    """Connect a Pioneer or a ROS 2 robot to Zenoh: one driver at a time drives it, within limits.

    Publishes odometry, transforms, battery, sonar, bumpers and diagnostics as ROS 2 messages, and passes
    commands on through a gate. Only the holder of the lease drives; the rover stops when no valid command
    arrives, and no command beyond the limits reaches it. Motors are off until a driver asks for them. It is
    ready when it prints
    "ready zenoh=... base=..."; Ctrl-C or SIGTERM stops the rover and ends it.
    """
    from bridge.app import run_bridge

    if not base.startswith("ros2/"):
        reject("is for a ROS 2 robot (ros2/tcp/HOST)", no_base_watchdog=no_base_watchdog)
    return run_bridge(
        base=base,
        listen=listen,
        namespace=namespace,
        model=model,
        limits=limits,
        zenoh_config=zenoh_config,
        base_zenoh_config=base_zenoh_config,
        ros=ros or [Convention.ROS2DDS],
        accept_ros=accept_ros,
        insecure=insecure,
        no_base_watchdog=no_base_watchdog,
        as_json=json,
    )


def urdf(
    model: Annotated[str, typer.Argument(help="A robot description: a name or a file.")] = USUAL_ROBOT,
    *,
    json: Json = False,
) -> None:
    """Print a robot's shape as a URDF, for RViz and robot_state_publisher.

    Its frames are those that the bridge publishes on tf_static.
    """
    from bridge.base import shape_of
    from bridge.ros.urdf import urdf as urdf_of
    from rover_ncp.core.console import Output
    from rover_ncp.core.robot_description import load_description

    text = urdf_of(shape_of(load_description(model)))
    Output(json).result({"model": model, "urdf": text}, text.rstrip())
