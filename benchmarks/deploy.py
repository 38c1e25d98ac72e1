"""How long the driver takes from an odometry sample to the command computed from it, and its CPU time.

    PYTHONPATH=tests python -m benchmarks.deploy --seconds 32

The driver is the real process, which records as in a drive. A peer in place of the bridge sends odometry 10,
50 and 100 times a second, grants the lease and executes commands exactly, so that no safety rule applies.
The recording names the sample of each command.
"""

import argparse
import math
import secrets
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import zenoh
from kit.peer import Peer

from bridge.zenoh.config import configured
from deploy.app import run
from deploy.drive.config import DriveConfig
from deploy.drive.records import TICKS_TOPIC, TickRecord
from deploy.recorder import Recorder
from deploy.zenoh_client import BridgeAddress
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.circuit.runner import Runner
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.console import Output
from rover_ncp.core.files import write_atomic
from rover_ncp.core.geometry import STANDSTILL, Pose
from rover_ncp.course.course import TICK_S, load_course
from rover_ncp.recording.recording import read_recording
from rover_ncp.wire.messages import odometry, read_text, read_twist, text
from rover_ncp.wire.protocol import (
    KEY_BYTES,
    CommandTag,
    GateStatus,
    MotorsReply,
    MotorsRequest,
    dump_json,
    parse_json,
)
from sim.mock.ros2_server import free_port
from sim.park.live import Process, ProcessError, TimedOut, wait_for

RATES_HZ = (10.0, 50.0, 100.0)
CIRCUIT_TICKS, CIRCUIT_REPEATS = 500, 20
START_S, EXTRA_S = 120.0, 60.0
STATUS_NS = 100_000_000


class Bridge(Peer):
    """Stands in for the bridge; its moments are those of the machine's monotonic clock, in ns."""

    def __init__(self, rate_hz: float) -> None:
        self.robot = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
        super().__init__(configured(self.robot, None, False, "cmd_vel")[0])
        self.sent: dict[int, int] = {}
        """The moment at which each sample was sent, by its stamp."""
        self.commands: dict[int, int] = {}
        """The moment at which the driver handed each command over, by its sequence number."""
        self._period_ns, self._lock = round(1e9 / rate_hz), threading.Lock()
        self._leases, self._leased, self._velocity = 0, False, STANDSTILL
        self._pose = Pose(0.0, 0.0, 0.0)
        subscribe: Any = self.session.declare_subscriber
        self._declared = [
            subscribe("cmd_vel", self._command),
            self.session.declare_queryable("rover/motors", self._motors),
            self.session.liveliness().declare_token("rover/alive/bridge"),
        ]

    def run(self) -> None:
        """Send odometry and the gate's status."""
        declare: Any = self.session.declare_publisher
        odom = declare("odom", congestion_control=zenoh.CongestionControl.DROP)
        due_ns = status_ns = time.monotonic_ns()
        while not self.closing.is_set():
            time.sleep(max(due_ns - time.monotonic_ns(), 0) * 1e-9)
            stamp_ns, payload = self._odometry(self._period_ns * 1e-9)
            self.sent[stamp_ns] = time.monotonic_ns()
            odom.put(payload)
            if due_ns >= status_ns:
                status_ns += STATUS_NS
                self._publish_status()
            due_ns += self._period_ns

    def _odometry(self, seconds: float) -> tuple[int, bytes]:
        with self._lock:
            (x, y, theta), (v, omega) = self._pose, self._velocity
            middle = theta + 0.5 * omega * seconds
            x, y = x + v * seconds * math.cos(middle), y + v * seconds * math.sin(middle)
            self._pose = Pose(x, y, math.remainder(theta + omega * seconds, math.tau))
            stamp_ns = time.time_ns()
            return stamp_ns, odometry(self._pose, self._velocity, stamp_ns)

    def _publish_status(self) -> None:
        lease = self._leases if self._leased else 0
        sequence = max(self.commands, default=-1)
        status = GateStatus(lease=lease, driver_name="benchmark" if lease else "", sequence=sequence)
        self.session.put("rover/gate", text(dump_json(status).decode()))

    def _command(self, sample: zenoh.Sample) -> None:
        if sample.attachment is not None:
            tag = CommandTag.unpack(sample.attachment.to_bytes())
            self.commands[tag.sequence] = tag.stamp_ns
            with self._lock:
                self._velocity = read_twist(sample.payload.to_bytes()).velocity

    def _motors(self, query: zenoh.Query) -> None:
        with query:
            request = parse_json(MotorsRequest, query.payload.to_bytes() if query.payload else b"")
            self._leased, self._velocity = request.enable, STANDSTILL
            self._leases += request.enable
            grant = MotorsReply(granted=True, lease=self._leases, key=secrets.token_hex(KEY_BYTES))
            query.reply("rover/motors", dump_json(grant))
        self._publish_status()


def delays_ms(ticks: list[TickRecord], sent: dict[int, int], commands: dict[int, int]) -> list[float]:
    """Return for each command of the recorded ``ticks`` the time since its newest odometry sample, in ms.

    A tick on prediction has no sample, so it is left out.
    """
    found = []
    for tick in ticks:
        stamps = [ref.stamp_ns for ref in tick.samples if ref.topic == "odom"]
        if stamps and tick.sequence in commands:
            found.append((commands[tick.sequence] - sent[max(stamps)]) * 1e-6)
    return found


def measure(rate_hz: float, seconds: float) -> str:
    """Return a row of the table. Raises ProcessError and TimedOut if the drive is stopped."""
    ticks = round(seconds * rate_hz)
    with tempfile.TemporaryDirectory() as name, ExitStack() as running:
        folder, peer = Path(name), Bridge(rate_hz)
        running.callback(peer.close)
        peer.start()
        recording = folder / "run.mcap"
        arguments = [peer.robot, str(_course(folder, ticks)), str(recording), str(1.0 / rate_hz)]
        driver = running.enter_context(Process("deploy", arguments, folder, __file__))
        wait_for(lambda: not driver.running or peer.commands, START_S, "the driver's first command")
        cpu_s: list[tuple[float, float]] = []
        while driver.running and len(peer.commands) < ticks - 1:
            cpu_s.append((_cpu_s(driver.pid), time.monotonic()))
            time.sleep(0.02)
        if not cpu_s or driver.wait(EXTRA_S).code not in {0, 1}:
            raise driver.failure()
        records = [
            parse_json(TickRecord, read_text(message.data).encode())
            for message in read_recording(recording).topic(TICKS_TOPIC)
        ]
    delays = delays_ms(records, peer.sent, peer.commands)
    p50, p99 = np.percentile(delays, [50, 99])
    share = (cpu_s[-1][0] - cpu_s[0][0]) / (cpu_s[-1][1] - cpu_s[0][1])
    predicted = sum(record.predicted for record in records)
    return (
        f"{rate_hz:5.0f} Hz {p50:8.2f} {p99:8.2f} {max(delays):8.2f} {len(delays):8} {predicted:9} "
        f"{1e3 * share / rate_hz:11.2f} {100 * share:9.0f} %"
    )


def _circuit_us() -> float:
    """Return the median CPU time of a tick of a shipped circuit, called as the driver calls it, in µs."""
    runner, observation = Runner(load_policy("parking")), np.array([0.3, 0.3, 0.3, 1.0])
    runner.tick(observation)
    times = []
    for _ in range(CIRCUIT_REPEATS):
        began = time.thread_time()
        for _ in range(CIRCUIT_TICKS):
            runner.tick(observation)
        times.append((time.thread_time() - began) / CIRCUIT_TICKS)
    return float(np.median(times)) * 1e6


def _course(folder: Path, ticks: int) -> Path:
    """Write the parking course with as many ticks; its start signal comes with the last one.

    The rover then does not move, so its simulated time may run faster than a rover could follow.
    """
    parking = load_course("parking")
    horizon_s = max(round(ticks * TICK_S, 1), parking.horizon_s)
    course = parking.model_copy(update={"start_signal_s": horizon_s - TICK_S, "horizon_s": horizon_s})
    path = folder / "course.yaml"
    write_atomic(path, dump_yaml(course.model_dump(mode="json")))
    return path


def _cpu_s(pid: int) -> float:
    """Return the CPU time of a process so far."""
    times = psutil.Process(pid).cpu_times()
    return float(times.user + times.system)


def drive(robot: str, course: str, recording: str, period_s: str) -> int:
    """Run ``rover-ncp deploy`` with ticks of another length, as the child process of `measure`."""
    policy, goal = load_policy("parking"), load_course(course)
    return run(
        BridgeAddress(robot),
        Output(True),
        policy=policy,
        course=goal,
        config=DriveConfig(robot=robot, policy="parking", course=goal.name, ticks=goal.ticks),
        recorder=Recorder(Path(recording)),
        period_s=float(period_s),
    )


def main() -> None:
    """Print a row for each rate."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--seconds", type=float, default=60.0, help="duration of each rate's measurement")
    seconds = options.parse_args().seconds
    print(f"a tick of the circuit takes {_circuit_us():.1f} µs of CPU time")
    print("    rate   median     99 %      max commands predicted CPU ms/tick of a core")
    for rate_hz in RATES_HZ:
        try:
            print(measure(rate_hz, seconds), flush=True)
        except (ProcessError, TimedOut) as error:  # on a busy machine a safety rule may stop a drive
            print(f"{rate_hz:5.0f} Hz not measured: {error}", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["deploy"]:
        sys.exit(drive(*sys.argv[2:-1]))
    main()
