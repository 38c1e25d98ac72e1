"""Mock, spoilable link, bridge and drivers as real processes, and the rows of the safety matrix they yield.

Every row ends in ``docs/safety.md`` when ``python tests/safety_table.py`` runs the matrix.
"""

import json
import os
import signal
import threading
import time
from pathlib import Path

from sim.studies.hand import Hand
from sim.studies.processes import Process
from sim.studies.proxy import Proxy
from sim.studies.standstill import TruthReader

STOP_S, WATCHDOG_S = 0.5, 2.0
"""The first safety requirement, and the base's own watchdog."""
BRAKING_M_S2, DELAY_S = 0.31, 0.15
"""The mock's, as a Pioneer's: what 'plus braking' means."""
SPEED = 0.12
HANGABLE = "sim.studies.hang"
COURSE = Path(__file__).parent / "data" / "prompt_course.yaml"
WALL = COURSE.with_name("wall_course.yaml")
ROWS_FILE = os.environ.get("ROVER_NCP_SAFETY_ROWS")


def braking_s(v):
    return DELAY_S + abs(v) / BRAKING_M_S2


def record(layer, fault, seconds, v, bound_s=STOP_S):
    """Hold a measured time to standstill against its bound, and note it."""
    row = {
        "layer": layer,
        "fault": fault,
        "seconds": round(seconds, 2),
        "bound_s": bound_s,
        "braking_s": round(braking_s(v), 2),
    }
    if ROWS_FILE:
        with Path(ROWS_FILE).open("a") as file:
            file.write(json.dumps(row) + "\n")
    assert seconds <= bound_s + braking_s(v), row


def wait_for(condition, timeout_s=8.0):
    deadline = time.monotonic() + timeout_s
    while not (found := condition()):
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)
    return found


class Stack:
    """``robot`` is the bridge itself; ``spoilt`` leads there through ``proxy``.

    ``mock`` and ``bridge`` are more arguments for these.
    """

    def __init__(self, folder: Path, *faults, mock=(), bridge=()):
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self._deploys, self._bridge_arguments = folder, 0, bridge
        truth = folder / "truth.csv"
        mock = ["--listen", "127.0.0.1:0", "--truth", str(truth), *mock]
        for fault in faults:
            mock += ["--fault", fault]
        self.processes = [Process("mock", mock, folder)]
        self.mock = self.processes[0]
        self.proxy = None
        try:
            self._base = self.mock.wait_for_line("listening on ")
            self.start_bridge("tcp/127.0.0.1:0")
            self.truth = TruthReader(truth)
            self.proxy = Proxy(self.robot.removeprefix("tcp/"))
            self.spoilt = f"tcp/127.0.0.1:{self.proxy.port}"
            self._watcher = self.hand()
            self._watcher.silent, self._watcher.greedy = True, False
            self.first_enabled_ns = None
            """When the gate first gave somebody the motors: the zero of the mock's scheduled faults."""
            self._watching = threading.Event()
            threading.Thread(target=self._watch, daemon=True).start()
        except BaseException:
            self.close()
            raise

    def start_bridge(self, listen=None):
        arguments = ["--base", f"tcp/{self._base}", "--listen", listen or self.robot, *self._bridge_arguments]
        self.bridge = Process("bridge", arguments, self.folder, HANGABLE)
        self.processes.append(self.bridge)
        ready = dict(part.split("=", 1) for part in self.bridge.wait_for_line("ready ").split())
        self.robot = ready["zenoh"]

    def _watch(self):
        while not self._watching.wait(0.002):
            if self._watcher.gate.driver:
                self.first_enabled_ns = time.time_ns()
                return

    def deploy(self, *options, robot=None):
        """Start a driver; it ends when the test is over with it."""
        self._deploys += 1
        folder = self.folder / f"deploy{self._deploys}"
        folder.mkdir()
        arguments = ["--robot", robot or self.robot, "--course", str(COURSE), *options]
        process = Process("deploy", arguments, folder, HANGABLE)
        self.processes.append(process)
        return process

    def hand(self, robot=None, **options):
        return Hand(robot or self.robot, **options)

    def speed(self):
        rows = self.truth.read()
        return rows[-1].v if rows else 0.0

    def under_way(self, hand, v=SPEED):
        """Let a hand drive, and wait until the rover does."""
        hand.velocity = hand.velocity._replace(v=v)
        wait_for(lambda: abs(self.speed() - v) < 0.01)
        return hand

    def driven(self, deploy):
        """Wait until a deploy has the rover moving."""
        wait_for(lambda: not deploy.running or abs(self.speed()) > 0.05, 20.0)
        if not deploy.running:
            raise deploy.failure()

    def stood(self, since_ns, timeout_s=6.0):
        return self.truth.stood_after(since_ns, timeout_s)

    def at(self, wall_ns):
        """The true speed at a moment."""
        return next((row.v for row in reversed(self.truth.read()) if row.wall_ns <= wall_ns), 0.0)

    def close(self):
        if self.proxy is not None:
            self._watching.set()
            self._watcher.close()
            self.truth.close()
            self.proxy.close()
        for process in reversed(self.processes):
            process.send_signal(signal.SIGCONT)
            process.stop()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
