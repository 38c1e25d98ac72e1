"""A drive on the virtual clock before a real bridge and base; what the driver receives can be changed."""

import contextlib
import functools
from pathlib import Path

from deploy.drive.config import DriveConfig
from deploy.drive.control_loop import Drive
from deploy.drive.controller import Controller, CourseMission
from deploy.drive.link import Arrival
from deploy.drive.records import attachments
from deploy.drive.result import result_of
from deploy.drive.tick_messages import Publisher
from deploy.estimator.inputs import Acceptance
from deploy.estimator.settings import EstimatorSettings
from deploy.zenoh_client import BridgeFilter
from kit.paths import DATA
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.geometry import ORIGIN, STANDSTILL, compose, relative
from rover_ncp.course.course import TICK_S, Course, load_course
from rover_ncp.recording.recording import Recorded, Recording, RecordingWriter
from rover_ncp.wire.key_table import spec
from rover_ncp.wire.messages import odometry, read_odometry, read_text, text, twist_stamped
from rover_ncp.wire.protocol import (
    BaseReply,
    BaseRequest,
    DriverStatus,
    GateStatus,
    Signed,
    dump_json,
    parse_json,
)
from sim.base.firmware import Firmware
from sim.stack.virtual import VirtualBridge, VirtualLink
from sim.world.described import default_rover
from sim.world.pymunk_rover import Ground, PymunkRover

AHEAD = load_policy(DATA / "golden/parking.yaml")
"""A circuit that drives straight ahead at full speed after the start signal."""


def short_course(x=0.0, y=0.0, **parked):
    """A course of 2 s to a place; ``parked`` are the tolerances of its rule."""
    goal = {"t": 2.0, "x": x, "y": y, "theta": 0.0}
    times = {"name": "short", "start_signal_s": 0.3, "horizon_s": 2.0}
    return Course.model_validate(times | {"checkpoints": [goal], "parked": parked})


COURSE = short_course(5.0, 5.0)
"""Its goal is far from where any rover comes."""
LONG = load_course("parking").model_copy(update={"start_signal_s": 0.3})


@functools.cache
def controlled(
    policy=AHEAD, odom=ORIGIN, pose=ORIGIN, report=lambda *exact: exact, latency=0.003, model=None
):
    """Drive the course parking with a controller and a rover alone.

    Return the true poses (course frame), the ticks and the controller. ``odom`` is the origin of odometry,
    ``report`` returns what it makes of pose and velocity.
    """
    course = load_course("parking")
    rover = PymunkRover(model or default_rover(), Ground(), pose)
    controller = Controller(policy, course, EstimatorSettings())
    to_odom = compose(odom, relative(pose, ORIGIN))
    start, _ = report(compose(to_odom, rover.pose), STANDSTILL)
    controller.start(start, -TICK_S, pose)
    poses, ticks = [], []
    for index in range(course.ticks):
        poses.append(rover.pose)
        measured = report(compose(to_odom, rover.pose), rover.velocity)
        assert controller.estimator.odometry(*measured, index * TICK_S) is Acceptance.ACCEPTED
        ticks.append(controller.tick(index, index * TICK_S + latency))
        rover.command(*ticks[-1].command)
        for _ in range(10):
            rover.substep()
    return poses, ticks, controller


class ChangedLink(VirtualLink):
    """Records in both directions, as the link of a process.

    ``change`` has a function for messages of a name, which returns what arrives instead of a message, or None
    if nothing does. ``harm`` is called once, with the command of number ``after``.
    """

    def __init__(self, bridge, record):
        super().__init__(bridge, ORIGIN, record)
        self.bridge, self.change = bridge, {}
        self.tag = lambda data, sequence: None
        self._filter = BridgeFilter(lambda: [BRIDGE])
        self.sent, self.sent_ns, self.statuses = [], [], []
        self.after, self.harm = 6, lambda: None
        self.released_ns, self.requests = None, 0

    def other_model(self, robot):
        return ""

    def other_profile(self, profile):
        return ""

    def put(self, name, data):
        """Deliver a message, as a peer does that is not the bridge."""
        wall_ns = self.bridge.time_ns()
        self._record(Recorded(name, spec(name).type, data, wall_ns, wall_ns))
        self.receive(name, Arrival(data, self.bridge.now_ns))

    def put_from(self, peer, name, data):
        """Deliver a message of a peer if the driver's filter takes it."""
        if self._filter.accepts(spec(name), peer):
            self.put(name, data)

    def put_with_odometry(self, name, messages, change=lambda data: data):
        """Deliver before each sample of odometry what ``messages`` returns for it; ``change`` is its own."""

        def put(data):
            for message in messages(read_odometry(data)):
                self.put(name, message)
            return change(data)

        self.change["odom"] = put

    def change_odometry(self, change):
        """Have ``change`` return pose and velocity of each sample of odometry, or None."""

        def changed(data):
            found = change(sample := read_odometry(data))
            return found and odometry(*found, sample.stamp_ns)

        self.change["odom"] = changed

    def change_gate(self, **fields):
        """Change fields of each status of the gate."""

        def changed(data):
            status = parse_json(GateStatus, read_text(data))
            return text(dump_json(status.model_copy(update=fields)).decode())

        self.change["rover/gate"] = changed

    def publish(self, name, data, wall_ns):
        if name == "rover/status":
            self.statuses.append(parse_json(DriverStatus, read_text(data)))
        self._record(Recorded(name, spec(name).type, data, wall_ns, wall_ns))

    def command(self, velocity):
        wall_ns = self.bridge.time_ns()
        data = twist_stamped(velocity, wall_ns)
        tag = self.lease.sign(Signed.COMMAND, "cmd_vel", data, self.bridge.now_ns)
        changed = self.tag(data, tag.sequence) or tag
        if changed is not LOST:
            self.bridge.command(data, changed.pack())
        self._record(Recorded("cmd_vel", spec("cmd_vel").type, data, wall_ns, wall_ns, tag.sequence))
        self.sent.append(velocity)
        self.sent_ns.append(self.bridge.now_ns)
        if len(self.sent) == self.after:
            self.harm()
        return tag.sequence

    def request_motors(self, name):
        self.requests += 1
        return super().request_motors(name)

    def about_base(self):
        return parse_json(BaseReply, self.bridge.query("rover/base", dump_json(BaseRequest())))

    def release(self):
        self.released_ns = self.bridge.now_ns
        super().release()

    def _receive(self, name, data):
        data = self.change.get(name, lambda data: data)(data)
        if data is not None:
            self.put_from(BRIDGE, name, data)


BRIDGE = "bridge"
STAYS_NS = 300_000_000
"""How long a rover must stand that stays where it is: the gate sends three statuses meanwhile."""
LOST = object()
"""A tag of `ChangedLink.tag`: the command does not arrive."""


class VirtualDrive:
    """One drive; ``path`` is its recording, and other arguments are those of its settings."""

    staging = None
    """The policy of another drive before the one of ``policy``."""

    def __init__(self, policy=AHEAD, course=COURSE, path=None, **settings):
        defaults = {"robot": "virtual", "policy": "p", "course": "c", "pose": "none", "ticks": course.ticks}
        self.config = DriveConfig(**defaults | settings)
        self.policy, self.course, self.path = policy, course, path
        self._place(Ground(()), ORIGIN)

    def _place(self, ground, start):
        self.rover = PymunkRover(default_rover(), ground, start)
        self.base = Firmware("p3at-sh", self.rover)
        self.bridge = VirtualBridge(self.base)
        self.recorded = []
        self.link = ChangedLink(self.bridge, self.recorded.append)
        self.interrupted = lambda: False

    def mission(self):
        config = self.config
        controller = Controller(self.policy, self.course, config.estimator, config.rover, config.described)
        return CourseMission(controller, config)

    def run(self):
        """Drive; return the result as JSON has it."""
        self._files = attachments(self.policy, self.course, self.config, self.staging)
        publisher = Publisher(
            self.link,
            self.recorded.append,
            self.policy.circuit.neurons,
            self.bridge,
            frame=self.config.pose_frame,
        )
        drive = Drive(self.link, self.mission(), publisher, self.config, self.interrupted, clock=self.bridge)
        try:
            drive.wait()
            drive.run()
        finally:
            if self.path:
                self._write()
        self.result = result_of(drive, {"recording": None, "recording_failure": None, "recording_dropped": 0})
        return self.result

    @property
    def recording(self):
        """What is recorded, without a file."""
        return Recording(Path("run.mcap"), self._files, {}, tuple(self.recorded), complete=True)

    def _write(self):
        with RecordingWriter(self.path) as writer:
            for name, content in self._files.items():
                writer.attach(name, content)
            for message in self.recorded:
                writer.write(message)

    def use_in(self, module, monkeypatch):
        """Have each drive of a module be one of this rover, with a link of its own."""

        @contextlib.contextmanager
        def link(address, record, **_):
            self.link = ChangedLink(self.bridge, record)
            yield self.link

        monkeypatch.setattr(module, "ZenohLink", link)
        monkeypatch.setattr(module, "Drive", functools.partial(Drive, clock=self.bridge))
        monkeypatch.setattr(module, "Publisher", functools.partial(Publisher, clock=self.bridge))
        monkeypatch.setattr(module, "prepare_for_real_time", lambda: None)

    def messages(self, topic):
        """Return the data of the recorded messages of a topic."""
        return [message.data for message in self.recorded if message.topic == topic]

    def stands(self):
        """Return whether the rover comes to a stand in the time that braking takes, and stays there."""
        since_ns = self.bridge.now_ns

        def stays():
            nonlocal since_ns
            if max(map(abs, self.rover.velocity)) >= 1e-3:
                since_ns = self.bridge.now_ns
            return self.bridge.now_ns - since_ns >= STAYS_NS

        self.bridge.wait(1.0 + STAYS_NS / NS_PER_S, stays)
        return stays()
