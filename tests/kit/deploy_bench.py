"""A bridge with its base in this process, on real Zenoh and in real time, and a driver against it."""

import functools
import json
import threading
import time

from deploy.commands import deploy
from deploy.drive import config
from deploy.drive.config import DriveConfig
from kit.paths import DATA
from kit.virtual_bench import STEP_S, VirtualRig
from kit.virtual_drive import COURSE
from kit.zenoh_session import open_router
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.console import Output, unwritten
from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.robot.description import load_description
from rover_ncp.wire.messages import read_twist
from rover_ncp.wire.protocol import CommandTag, MotorsReply, MotorsRequest, dump_json, parse_json


class Bridge(VirtualRig):
    """A rig whose clock follows the machine's; its answers can be late, or refuse the motors."""

    def __init__(self):
        self.session, self.robot = open_router()
        self.refusal = ""
        self.delays = []
        """Of the next answers, in s."""
        self.commands, self.requests = [], []
        self.released = threading.Event()
        self._closing, self._lock = threading.Event(), threading.Lock()
        super().__init__(load_description(DEFAULT_ROBOT))
        self.sleep(3.0)  # until the base is connected
        self._token = self.session.liveliness().declare_token("rover/alive/bridge")
        self._held = [
            self.session.declare_subscriber("cmd_vel", self._command),
            self.session.declare_queryable("rover/motors", self._answer),
            self.session.declare_queryable("rover/stop", self._stop),
        ]
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        began_s = time.monotonic() - self.monotonic()
        while not self._closing.wait(STEP_S):
            with self._lock:
                self.sleep(time.monotonic() - began_s - self.monotonic())

    def publish(self, name, data):
        self.session.put(name, data)

    def _command(self, sample):
        payload, tag = sample.payload.to_bytes(), sample.attachment.to_bytes()
        with self._lock:
            self.command(payload, tag)
        self.commands.append((CommandTag.unpack(tag), read_twist(payload).velocity))

    def _answer(self, query):
        with query:
            payload = query.payload.to_bytes()
            request = parse_json(MotorsRequest, payload)
            self.requests.append(request)
            with self._lock:
                tag = query.attachment and query.attachment.to_bytes()
                reply = self.query("rover/motors", payload, tag)
            if self.refusal:
                reply = dump_json(MotorsReply(granted=False, reason=self.refusal, detail="it is pressed"))
            time.sleep(self.delays.pop(0) if self.delays else 0.0)
            query.reply("rover/motors", reply)
            if not request.enable:
                self.released.set()

    def _stop(self, query):
        with query, self._lock:
            query.reply("rover/stop", self.query("rover/stop", query.payload.to_bytes()))

    def vanish(self):
        self._token.undeclare()

    def after_commands(self, count, action):
        """Do something, once, as soon as so many commands have come."""

        def wait():
            while len(self.commands) < count:
                if self._closing.wait(0.005):
                    return
            action()

        threading.Thread(target=wait, daemon=True).start()

    def close(self):
        self._closing.set()
        self._thread.join()
        self.session.close()


def driver(bridge, folder, capsys, monkeypatch):
    """Return what drives once, straight ahead for 2 s, and returns exit code and result."""
    course = folder / "short.yaml"
    course.write_text(dump_yaml(COURSE.model_dump(mode="json")))

    def drive(**changes):
        waits = {"still_s": 0.15, "bridge_wait_s": 0.3}
        monkeypatch.setattr(config, "DriveConfig", functools.partial(DriveConfig, **waits))
        options = {
            "robot": bridge.robot,
            "policy": str(DATA / "golden/parking.yaml"),
            "course": str(course),
            "record": folder / "run.mcap",
            "json": True,
        }
        options["record"].unlink(missing_ok=True)  # of the drive before
        code = deploy(**options | changes)
        unwritten()
        Output.lines = None
        return code, json.loads(capsys.readouterr().out)

    return drive
