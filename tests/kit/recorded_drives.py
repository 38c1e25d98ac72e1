"""A drive as deploy would have recorded it, made from a simulated one: nothing here needs a process."""

from pathlib import Path

import numpy as np

from rover_ncp.circuit.policy_file import load_policy, policy_to_yaml
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.geometry import Pose, Velocity, compose
from rover_ncp.course.course import load_course
from rover_ncp.recording.recording import Recorded, RecordingWriter
from rover_ncp.wire import messages
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.key_table import TAG_VIEW, spec
from rover_ncp.wire.protocol import DriverStatus, GateStatus, dump_json
from sim.learn.rollout import rollout

BEGAN_NS = 1_700_000_000_000_000_000
TICK_NS = 100_000_000
ODOM_START = Pose(3.0, -2.0, 1.0)
"""Where odometry stands when the drive begins: anywhere."""


def state(model, ns):
    """Return the message of a driver's or a gate's status."""
    topic = {DriverStatus: "rover/status", GateStatus: "rover/gate"}[type(model)]
    return Recorded(topic, spec(topic).type, messages.text(dump_json(model).decode()), ns, ns)


def picture(ns, jpeg):
    """Return the message of a localiser's picture."""
    data = encode(spec(TAG_VIEW).type, format="jpeg", data=np.frombuffer(jpeg, np.uint8))
    return Recorded(TAG_VIEW, spec(TAG_VIEW).type, data, ns, ns)


def drive_messages(policy, course, truth=True, variance=1e-6):
    """Return the messages of a drive in order, and the rollout they were made from.

    The covariance of the estimate begins with ``variance`` and grows.
    """
    run = rollout(policy, course)
    told = []

    def put(topic, data, ns):
        ros_type = "geometry_msgs/msg/PoseStamped" if topic == "truth/pose" else spec(topic).type
        told.append(Recorded(topic, ros_type, data, ns, ns))

    def odom(pose, v, omega, ns):
        put("odom", messages.odometry(compose(ODOM_START, pose), Velocity(v, omega), ns), ns)

    def status(phase, tick, ns):
        told.append(state(DriverStatus(state=phase, tick=tick, t_s=0.1 * tick), ns))

    def gate(ns, **fields):
        told.append(state(GateStatus(**fields), ns))

    gate(BEGAN_NS - 5 * TICK_NS, held="no-lease")
    status("armed", 0, BEGAN_NS - 4 * TICK_NS)
    status("driving", 0, BEGAN_NS - 3 * TICK_NS)
    covariance = variance * np.diag([1.0, 2.0, 1.0])
    for k, pose in enumerate(map(Pose._make, run.poses)):
        ns = BEGAN_NS + k * TICK_NS
        last = k == len(run.commands)
        v, omega = run.commands[k] if not last else (0.0, 0.0)
        odom(pose, v, omega, ns - 5_000_000)
        if truth:
            put("truth/pose", messages.pose_stamped(pose, ns, "course"), ns)
        estimate = messages.pose_with_covariance(pose, covariance * (1 + k), ns, "course")
        put("rover/estimate", estimate, ns)
        if last:
            break
        put("rover/neurons", messages.neurons(run.potentials[k], policy.circuit.neurons), ns)
        put("cmd_vel", messages.twist_stamped(Velocity(v, omega), ns), ns)
        put("rover/cmd_out", messages.twist_stamped(Velocity(v, omega), ns), ns + 2_000_000)
        gate(ns + 3_000_000, lease=1, accepted=k + 1)
        status("driving", k, ns + 1_000_000)
    put("battery_state", messages.battery_state(12.8, BEGAN_NS), BEGAN_NS)
    status("parked" if run.verdict.parked else "ended", len(run.commands), ns + TICK_NS)
    told.sort(key=lambda message: message.log_ns)
    return told, run


def write_drive(
    path: Path, policy="parking", course="parking", truth=True, more=(), variance=1e-6, **settings
):
    """Write a recording of a policy on a course; return the rollout it was made from.

    ``settings`` are further ones of the driver.
    """
    known, policy = load_course(course), load_policy(policy)
    told, run = drive_messages(policy, known, truth, variance)
    with RecordingWriter(path) as writer:
        writer.attach("policy.yaml", policy_to_yaml(policy).encode())
        writer.attach("course.yaml", dump_yaml(known.model_dump(mode="json")).encode())
        driver = {"format": 1, "version": "0.1.0", "robot": "tcp/127.0.0.1:7447"}
        writer.attach("deploy.yaml", dump_yaml(driver | settings).encode())
        for message in sorted([*told, *more], key=lambda message: message.log_ns):
            writer.write(message)
    return run
