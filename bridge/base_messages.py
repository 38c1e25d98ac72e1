"""Base reports as ROS messages: frames of REP-105, axes and units of REP-103. Pure functions.

``odom`` is where the base was when it was connected; ``base_link`` is its centre of
rotation, on the ground. Sonar echoes are points in ``base_link``; where each sonar sits is in ``tf_static``.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from bridge.base import BaseReport, LinkHealth
from bridge.gate.state import GateState, Reason, describe
from bridge.pioneer.packets import NO_ECHO_MM
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.robot.description import RobotDescription
from rover_ncp.wire import messages
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.message_parts import header_of
from rover_ncp.wire.messages import BASE_FRAME, ODOM_FRAME, Transform, imu
from rover_ncp.wire.protocol import Fence, GateStatus

OK, WARNING, ERROR = 0, 1, 2
MIN_VARIANCE = 1e-6
"""Lower bound of every variance (SI squared): other filters read 0 as certain or unknown."""


class Variances(NamedTuple):
    """Variances of each report."""

    pose: tuple[float, float, float]
    """Of x and y in m², of the heading in rad²: noise, and the errors of 1 m and of a turn of 1 rad."""
    velocity: tuple[float, float]
    """Of v in (m/s)², of ω in (rad/s)²: the errors at the greatest speeds."""
    lateral: float
    """Of the speed to the side, in (m/s)²."""


class Diagnostic(NamedTuple):
    """One line of diagnostics; level 0 ok, 1 warning, 2 error."""

    name: str
    level: int
    message: str
    values: Mapping[str, str]


def odometry_variances(robot: RobotDescription) -> Variances:
    """Return the variances of a robot's odometry, constants of its description.

    `distance_error` and `turn_error` are half-widths of uniform distributions: σ = width/√3.
    """
    odometry, motion = robot.odometry, robot.motion
    per_m, per_rad = odometry.distance_error / math.sqrt(3), odometry.turn_error / math.sqrt(3)
    # A skid-steered robot turns about a point anywhere between its axles, and slides sideways meanwhile.
    # A differential drive has one axle: its lateral variance is the minimum.
    lateral_m = robot.wheels.axles_m / 2 / math.sqrt(3)
    position = _variance(odometry.noise_m, per_m)
    # The odometry's track, by which wheels of different sizes turn the heading; skid steering widens it.
    heading = _variance(odometry.noise_rad, per_rad, per_m / robot.track_m)
    return Variances(
        (position, position, heading),
        (_variance(per_m * motion.v_max), _variance(per_rad * motion.omega_max)),
        _variance(lateral_m * motion.omega_max),
    )


def _variance(*deviations: float) -> float:
    return max(sum(value * value for value in deviations), MIN_VARIANCE)


def each_report(
    report: BaseReport, robot: RobotDescription, stamp_ns: int, variances: Variances
) -> dict[str, bytes]:
    """Return the messages that go out with each report, by key."""
    pose = Pose(report.x, report.y, report.theta)
    sent = {
        "odom": messages.odometry(
            pose,
            Velocity(report.v, report.omega),
            stamp_ns,
            variances.pose,
            variances.velocity,
            lateral_variance=variances.lateral,
        ),
        "tf": messages.transforms(
            [Transform(ODOM_FRAME, BASE_FRAME, report.x, report.y, 0.0, report.theta)], stamp_ns
        ),
        "bumpers": messages.bumpers(*report.bumpers),
    }
    if report.sonar:
        sent["sonar"] = messages.point_cloud(_echoes(report.sonar, robot), stamp_ns)
    return sent


def _echoes(ranges: Mapping[int, float], robot: RobotDescription) -> list[tuple[float, float, float]]:
    points, sonars = [], robot.sonar_poses
    for number, range_m in ranges.items():
        if number < len(sonars) and 0.0 < range_m < NO_ECHO_MM / 1000:
            sonar = sonars[number]
            x = sonar.x + range_m * math.cos(sonar.theta)
            points.append((x, sonar.y + range_m * math.sin(sonar.theta), robot.sonar_height_m))
    return points


def each_second(report: BaseReport, robot: RobotDescription, stamp_ns: int) -> dict[str, bytes]:
    """Return the messages that go out once a second, by key."""
    return {
        "battery_state": messages.battery_state(
            report.battery_v, stamp_ns - round(report.battery_age_s * 1e9), charging=report.charging
        ),
        # Repeated for late subscribers that do not query earlier samples.
        "tf_static": messages.transforms(sensor_frames(robot), stamp_ns),
    }


def sensor_frames(robot: RobotDescription) -> list[Transform]:
    """Return where each sensor sits on the base."""
    return [
        Transform(BASE_FRAME, f"sonar_{number}", sonar.x, sonar.y, robot.sonar_height_m, sonar.theta)
        for number, sonar in enumerate(robot.sonar_poses)
    ]


def turn_rate(rate: float, robot: RobotDescription, stamp_ns: int) -> bytes:
    """Return the gyro's turn rate: rad/s, counter-clockwise."""
    noise_rad_s = robot.gyro.noise_rad_s if robot.gyro else 0.0
    return imu(rate, max(noise_rad_s**2, MIN_VARIANCE), stamp_ns)


def gate_status(state: GateState, fence: Fence | None = None) -> GateStatus:
    """Return the gate's state as it goes out on ``rover/gate``, with the gate's fence."""
    lease, held = state.lease, state.held
    return GateStatus(
        lease=lease.number if lease else 0,
        driver_name=lease.name if lease else "",
        sequence=lease.last_sequence if lease else -1,
        held="" if held in {None, Reason.NO_LEASE} else str(held),
        held_detail="" if held in {None, Reason.NO_LEASE} else describe(held, state),
        ended=str(state.lease_over or ""),
        ended_detail=state.lease_over_detail,
        stop_reason=state.stop_reason or "",
        accepted=state.accepted,
        dropped=_named(state.dropped),
        limited=_named(state.limited),
        stops=_named(state.stops),
        fence=fence,
    )


def _named(counts: Mapping[Reason, int]) -> dict[str, int]:
    return {str(reason): count for reason, count in counts.items()}


def diagnostics(
    base: BaseReport | None,
    gate: GateState,
    link: LinkHealth,
    *,
    reconnects: int,
    hardware: str,
    stamp_ns: int,
) -> bytes:
    """Return the health of link, base and gate."""
    status = [
        {
            "level": item.level,
            "name": item.name,
            "message": item.message,
            "hardware_id": hardware,
            "values": [{"key": name, "value": value} for name, value in item.values.items()],
        }
        for item in (_link(link, reconnects), _base(base), _gate(gate))
    ]
    head = header_of(stamp_ns, BASE_FRAME)
    return encode("diagnostic_msgs/msg/DiagnosticArray", header=head, status=status)


def _link(link: LinkHealth, reconnects: int) -> Diagnostic:
    values = {**link.counters, "reconnects": reconnects}
    return Diagnostic(
        "bridge: link to the base",
        WARNING if link.damaged else OK,
        "messages are damaged or cannot be used" if link.damaged else "clean",
        {name: str(value) for name, value in values.items()},
    )


def _base(base: BaseReport | None) -> Diagnostic:
    if base is None:
        return Diagnostic("bridge: base", ERROR, "not connected", {})
    troubles = {
        "STOP button pressed": base.stop_pressed,
        "stalled": any(base.stalled),
        "bumper pressed": any(base.bumpers),
        "reports faults": base.faults != 0,
    }
    found = ", ".join(trouble for trouble, there in troubles.items() if there)
    values = {
        "battery_v": f"{base.battery_v:.1f}",
        "motors": "on" if base.motors_on else "off",
        "flags": f"{base.flags:#06x}",
        "faults": f"{base.faults:#06x}",
        "stalled_left_right": f"{base.stalled[0]:d}{base.stalled[1]:d}",
        "bumpers_front_rear": f"{base.bumpers[0]:#04x} {base.bumpers[1]:#04x}",
    }
    return Diagnostic("bridge: base", ERROR if found else OK, found or "fine", values)


def _gate(gate: GateState) -> Diagnostic:
    status = gate_status(gate)
    values = {"driver": status.driver_name, "lease": str(status.lease), "accepted": str(status.accepted)}
    for name in ("dropped", "limited", "stops"):
        values |= {f"{name}_{reason}": str(count) for reason, count in getattr(status, name).items()}
    held = status.held or ("" if status.lease else status.ended)
    return Diagnostic("bridge: gate", WARNING if held else OK, held or "open", values)
