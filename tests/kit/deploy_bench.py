"""A bridge that can be made to fail, over real Zenoh on loopback TCP, and a driver against it."""

import functools
import json
import threading
import time

from deploy.commands import deploy
from deploy.drive import config
from deploy.drive.config import DriveConfig
from kit.zenoh_session import open_session
from rover_ncp.circuit.policy import parking_policy
from rover_ncp.circuit.policy_file import load_circuit, save_policy
from rover_ncp.core.geometry import Pose, Velocity, compose
from rover_ncp.wire.key_table import key
from rover_ncp.wire.messages import odometry, read_twist, text
from rover_ncp.wire.protocol import (
    CommandTag,
    GateStatus,
    MotorsReply,
    MotorsRequest,
    Signed,
    dump_json,
    parse_json,
)
from sim.pioneer.ros2_server import free_port

ODOM_AT_START = Pose(3.0, -2.0, 3.1)  # nowhere near the origin, and turning left crosses π
SIP_S = 0.1
STILL = Velocity(0.0, 0.0)
LEASE = 5


class Bridge:
    """Looks like a bridge to a driver; its rover obeys at once. ``odom`` may be replaced by a faulty one."""

    def __init__(self, namespace=""):
        self.namespace = namespace
        self.robot = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
        self.session = open_session("router", {"listen/endpoints": [self.robot], "scouting/delay": 0})
        self.pose, self.velocity = ODOM_AT_START, STILL
        self.odom = odometry
        self.gate = GateStatus()
        self.refusal = ""
        self.secret = bytes(range(32))
        self.delays = []
        """Of the next grants, in s."""
        self.drops = None
        """The reason to drop all commands; with "" it reports none."""
        self.accepted = -1
        """The number of the last accepted command."""
        self.commands, self.requests, self.times = [], [], []
        self.released = threading.Event()
        self._stop = threading.Event()
        self._token = self.session.liveliness().declare_token(self._key("rover/alive/bridge"))
        self._commands = self.session.declare_subscriber(self._key("cmd_vel"), self._command)
        self._motors = self.session.declare_queryable(self._key("rover/motors"), self._answer)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _key(self, name):
        return key(self.namespace, name)

    def _run(self):
        due = time.monotonic()
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            due += SIP_S
            v, omega = self.velocity
            self.pose = compose(self.pose, Pose(SIP_S * v, 0.0, SIP_S * omega))
            data = self.odom(self.pose, self.velocity, time.time_ns())
            if data is not None:
                self.times.append(time.monotonic())
                self.session.put(self._key("odom"), data)
            if self.gate is not None:
                self.session.put(self._key("rover/gate"), text(dump_json(self.gate).decode()))

    def _command(self, sample):
        tag = CommandTag.unpack(sample.attachment.to_bytes())
        velocity = read_twist(sample.payload.to_bytes()).velocity
        if self.gate is not None and tag.lease == self.gate.lease:
            assert tag.verify(self.secret, Signed.COMMAND, self._key("cmd_vel"), sample.payload.to_bytes())
            if self.drops is None:
                self.velocity = velocity
                self.gate = self.gate.model_copy(update={"sequence": tag.sequence})
                self.accepted = tag.sequence
            elif self.drops:
                dropped = {self.drops: self.gate.dropped.get(self.drops, 0) + 1}
                self.gate = self.gate.model_copy(update={"dropped": dropped})
        self.commands.append((tag, velocity))

    def _answer(self, query):
        with query:
            where, payload = self._key("rover/motors"), query.payload.to_bytes()
            request = parse_json(MotorsRequest, payload)
            self.requests.append(request)
            granted = request.enable and not self.refusal
            reply = MotorsReply(granted=granted, reason=self.refusal, detail="it is pressed", lease_s=1.0)
            if query.attachment is not None:  # a renewal or a release
                tag = CommandTag.unpack(query.attachment.to_bytes())
                assert tag.verify(self.secret, Signed.MOTORS, where, payload)
            if granted:
                secret = "" if query.attachment is not None else self.secret.hex()
                self.gate = GateStatus(lease=LEASE)
                reply = reply.model_copy(update={"lease": LEASE, "key": secret})
                time.sleep(self.delays.pop(0) if self.delays else 0.0)
            elif query.attachment is not None:
                self.gate, self.velocity = GateStatus(), STILL
            query.reply(where, dump_json(reply))
            if not request.enable:
                self.released.set()

    def publish_pose(self, data):
        self.session.put(self._key("pose"), data)

    def vanish(self):
        self._token.undeclare()

    def after_commands(self, count, action):
        """Do something, once, as soon as so many commands have come."""

        def wait():
            while len(self.commands) < count:
                if self._stop.wait(0.005):
                    return
            action()

        threading.Thread(target=wait, daemon=True).start()

    def close(self):
        self._stop.set()
        self._thread.join()
        self.session.close()


def untuned_policy(folder):
    """Write a policy that drives slowly and nowhere in particular."""
    path = folder / "untuned.yaml"
    save_policy(path, parking_policy(load_circuit("parking")))
    return path


def short_course(folder):
    """The start signal comes at once; the goal is far from where an untuned circuit goes."""
    path = folder / "short.yaml"
    path.write_text(
        "name: short\nstart_signal_s: 0.3\nhorizon_s: 2.0\n"
        "checkpoints:\n- {t: 2.0, x: 5.0, y: 5.0, theta: 0.0}\n"
    )
    return path


def driver(bridge, folder, capsys, monkeypatch):
    """Return what drives once with shorter waits, and returns exit code and result."""
    policy, course = untuned_policy(folder), short_course(folder)

    def drive(as_json=True, waits=(), **changes):
        waits = {"still_s": 0.15, **dict(waits)}
        monkeypatch.setattr(config, "DriveConfig", functools.partial(DriveConfig, **waits))
        options = {
            "robot": bridge.robot,
            "namespace": bridge.namespace,
            "policy": str(policy),
            "course": str(course),
            "record": folder / "run.mcap",
            "overwrite": True,
            "json": as_json,
        }
        code = deploy(**options | changes)
        said = capsys.readouterr().out
        return code, json.loads(said) if as_json else said

    return drive
