"""A bridge over real Zenoh on loopback TCP whose answers can be chosen, and a driver against it."""

import functools
import json
import threading
import time

from deploy.commands import deploy
from deploy.drive import config
from deploy.drive.config import DriveConfig
from kit.virtual_drive import COURSE
from kit.zenoh_session import open_session
from rover_ncp.circuit.policy import parking_policy
from rover_ncp.circuit.policy_file import load_circuit, save_policy
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.geometry import STANDSTILL, Pose, compose
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
LEASE = 5


class Bridge:
    """Looks like a bridge to a driver; its rover obeys at once."""

    def __init__(self):
        self.robot = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
        self.session = open_session("router", {"listen/endpoints": [self.robot], "scouting/delay": 0})
        self.pose, self.velocity = ODOM_AT_START, STANDSTILL
        self.gate = GateStatus()
        self.refusal = ""
        self.secret = bytes(range(32))
        self.delays = []
        """Of the next grants, in s."""
        self.commands, self.requests = [], []
        self.released = threading.Event()
        self._stop = threading.Event()
        self._token = self.session.liveliness().declare_token("rover/alive/bridge")
        self._commands = self.session.declare_subscriber("cmd_vel", self._command)
        self._motors = self.session.declare_queryable("rover/motors", self._answer)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        due = time.monotonic()
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            due += SIP_S
            v, omega = self.velocity
            self.pose = compose(self.pose, Pose(SIP_S * v, 0.0, SIP_S * omega))
            self.session.put("odom", odometry(self.pose, self.velocity, time.time_ns()))
            self.session.put("rover/gate", text(dump_json(self.gate).decode()))

    def _command(self, sample):
        tag = CommandTag.unpack(sample.attachment.to_bytes())
        velocity = read_twist(sample.payload.to_bytes()).velocity
        if tag.lease == self.gate.lease:
            assert tag.verify(self.secret, Signed.COMMAND, "cmd_vel", sample.payload.to_bytes())
            self.velocity = velocity
            self.gate = self.gate.model_copy(update={"sequence": tag.sequence})
        self.commands.append((tag, velocity))

    def _answer(self, query):
        with query:
            payload = query.payload.to_bytes()
            request = parse_json(MotorsRequest, payload)
            self.requests.append(request)
            granted = request.enable and not self.refusal
            reply = MotorsReply(granted=granted, reason=self.refusal, detail="it is pressed", lease_s=1.0)
            if query.attachment is not None:  # a renewal or a release
                tag = CommandTag.unpack(query.attachment.to_bytes())
                assert tag.verify(self.secret, Signed.MOTORS, "rover/motors", payload)
            if granted:
                secret = "" if query.attachment is not None else self.secret.hex()
                self.gate = GateStatus(lease=LEASE)
                reply = reply.model_copy(update={"lease": LEASE, "key": secret})
                time.sleep(self.delays.pop(0) if self.delays else 0.0)
            elif query.attachment is not None:
                self.gate, self.velocity = GateStatus(), STANDSTILL
            query.reply("rover/motors", dump_json(reply))
            if not request.enable:
                self.released.set()

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


def driver(bridge, folder, capsys, monkeypatch):
    """Return what drives once, slowly and nowhere in particular, and returns exit code and result."""
    policy, course = folder / "untuned.yaml", folder / "short.yaml"
    save_policy(policy, parking_policy(load_circuit("parking")))
    course.write_text(dump_yaml(COURSE.model_dump(mode="json")))

    def drive(**changes):
        waits = {"still_s": 0.15, "bridge_wait_s": 0.3}
        monkeypatch.setattr(config, "DriveConfig", functools.partial(DriveConfig, **waits))
        options = {
            "robot": bridge.robot,
            "policy": str(policy),
            "course": str(course),
            "record": folder / "run.mcap",
            "overwrite": True,
            "json": True,
        }
        code = deploy(**options | changes)
        return code, json.loads(capsys.readouterr().out)

    return drive
