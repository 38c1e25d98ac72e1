"""A robot behind a bridge as a Gymnasium environment, ``rover_ncp/Rover-v0``: any policy drives it.

Importing this module registers it; the part of the id before the colon makes Gymnasium import it:

    env = gymnasium.make("deploy.env:rover_ncp/Rover-v0", robot="tcp/192.168.1.20")

Observation, action, reward and step are those of ``sim.world.env:rover_ncp/RoverParking-v0``. The drive is
that of ``rover-ncp deploy``: lease, gate, estimator and safety checks, in a thread of its own. Rules:

1. The drive keeps the time. `step` gives it one action and returns with the next tick, 0.1 s later.
2. An action that does not come within ``ACTION_S`` ends the drive (rule ``action-late``).
3. `close`, an exception in `step`, Ctrl-C there and the end of the program stop the rover. A program that is
   killed sends no more commands, and the gate stops the rover.
"""

import atexit
import queue
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from deploy.app import prepare_for_real_time
from deploy.drive.config import PoseUse, config_for
from deploy.drive.control_loop import Drive
from deploy.drive.controller import Controller
from deploy.drive.mission import CourseMission
from deploy.drive.tick_messages import Publisher
from deploy.drive.zenoh_link import ZenohLink
from deploy.zenoh_client import BridgeAddress
from rover_ncp.circuit.rover_interface import DEFAULT_SIGNALS, FunctionRunner, RoverInterface
from rover_ncp.core.errors import RoverNcpError, SafetyStop
from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import TICK_S, Course, load_course
from rover_ncp.course.reference import plan_reference
from rover_ncp.course.scoring import due_checkpoints, reward
from rover_ncp.course.slowdown import slowed
from rover_ncp.course.spaces import ACTIONS, observation_space
from rover_ncp.recording.recording import Recorded
from rover_ncp.robot.description import load_description
from rover_ncp.robot.profile import load_profile

ENV_ID = "rover_ncp/Rover-v0"
ACTION_S = 0.25
"""The longest time for an action. The gate holds the rover 0.3 s after the last command."""

FloatArray = NDArray[np.float64]


class _Observed(NamedTuple):
    """What the drive hands over in a tick."""

    tick: int
    values: tuple[float, ...]
    """The signals of the environment."""
    pose: Pose


class _Handover(FunctionRunner):
    """The drive's `Runner`: hands each observation to the environment and waits for its action."""

    def __init__(self) -> None:
        super().__init__(self._exchange)
        self.drive: Drive | None = None
        self.controller: Controller | None = None
        self.observed: queue.Queue[_Observed | None] = queue.Queue()
        """None says that the drive is over."""
        self.actions: queue.Queue[tuple[float, float]] = queue.Queue()

    def _exchange(self, observation: FloatArray) -> tuple[float, float]:
        """Return the environment's action. Raises SafetyStop if none comes in time."""
        assert self.drive is not None and self.controller is not None  # ticks belong to a drive
        pose = self.controller.estimate.pose
        self.observed.put(_Observed(self.drive.keeper.index, tuple(observation.tolist()), pose))
        try:
            return self.actions.get(timeout=ACTION_S)
        except queue.Empty:
            words = f"the environment's user gave no action within {ACTION_S:g} s of the observation"
            raise SafetyStop("action-late", words) from None


class RoverEnv(gymnasium.Env[FloatArray, FloatArray]):
    """Drive a real rover through the checkpoints of a course, each at its time.

    ``signals`` names what is observed, see rover_ncp/course/signals.py; by default the estimated pose in the
    course's frame and the start signal. ``robot``, ``namespace``, ``zenoh_config``, ``model``,
    ``profile`` and ``pose`` are the options of ``rover-ncp deploy``.

    `reset` connects, waits until the rover stands still, takes its place there as the course's start and
    requests the motors. It raises what ``rover-ncp deploy`` would report: RoverNcpError with its exit code.

    *Terminated*: the course's horizon is reached. *Truncated*: a safety rule stopped the rover; ``info`` has
    its name as ``stopped_by``. At every end ``info`` holds ``verdict`` (by the estimate) and ``reason``.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  # gymnasium declares it so

    def __init__(
        self,
        robot: str,
        course: str | Path | Course = "parking",
        *,
        signals: Sequence[str] = (),
        namespace: str = "",
        zenoh_config: str | Path | None = None,
        model: str | Path | None = None,
        profile: str | Path | None = None,
        pose: PoseUse = "auto",
    ) -> None:
        self.signals = tuple(signals) or DEFAULT_SIGNALS
        self._interface = RoverInterface(self.signals)
        self._address = BridgeAddress(robot, namespace, Path(zenoh_config) if zenoh_config else None)
        self._robot = load_description(str(model)) if model else None
        self._profile = load_profile(Path(profile)) if profile else None
        self.course = course if isinstance(course, Course) else load_course(course)
        if self._robot is not None:
            self.course, _ = slowed(self.course, self._robot)
        self._reference = plan_reference(self.course) if self._interface.needs_reference else None
        self._pose, self._due = pose, due_checkpoints(self.course)
        self.observation_space = observation_space(self.signals)
        self.action_space = ACTIONS
        self._error: Exception | None = None
        """The exception by which the drive ended."""
        self._thread: threading.Thread | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Begin a drive where the rover stands. A running drive ends first."""
        super().reset(seed=seed, options=options)
        self.close()
        self._closing, self._error = threading.Event(), None
        self._handover, self._tick = _Handover(), 0
        drive = self._handover, self._closing
        self._thread = threading.Thread(target=self._run, args=drive, name="rover drive", daemon=True)
        atexit.register(self.close)
        self._thread.start()
        observed = self._next()
        if observed is None:
            self.close()
            raise self._error or RoverNcpError("the drive ended before its first tick")
        self._tick = observed.tick
        return np.array(observed.values, np.float64), {"time_s": TICK_S * observed.tick}

    def step(self, action: ArrayLike) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Command (v, omega) in m/s and rad/s, and return what is observed a tick later."""
        if self._thread is None:
            raise gymnasium.error.ResetNeeded("the drive is over: call reset() first")
        observed = self._next(action)
        if observed is None:
            return self._ended()
        gain = self._reward(self._tick, observed.tick, observed.pose)
        self._tick = observed.tick
        return np.array(observed.values, np.float64), gain, False, False, {"time_s": TICK_S * self._tick}

    def close(self) -> None:
        """Stop the rover, release the lease and disconnect; return when that is done."""
        if self._thread is not None:
            self._closing.set()
            self._handover.actions.put((0.0, 0.0))  # a tick may wait for it
            self._thread.join()
            self._thread = None
            atexit.unregister(self.close)

    def _run(self, handover: _Handover, closing: threading.Event) -> None:
        """Drive once, in the drive's thread."""
        try:
            self._drive(handover, closing)
        except KeyboardInterrupt:  # `close` ended it before its first tick
            pass
        except Exception as error:
            self._error = error
        finally:
            handover.observed.put(None)

    def _drive(self, handover: _Handover, closing: threading.Event) -> None:
        config = config_for(
            self.course,
            self._profile,
            self._robot,
            robot=self._address.robot,
            namespace=self._address.namespace,
            policy="gymnasium",
            pose=self._pose,
        )
        controller = Controller(
            self.signals, self.course, config.estimator, self._profile, self._robot, runner=handover
        )
        prepare_for_real_time()
        with ZenohLink(self._address, _not_recorded) as link:
            publisher = Publisher(link, _not_recorded, ())
            drive = Drive(link, CourseMission(controller, config), publisher, config, closing.is_set)
            handover.drive, handover.controller = drive, controller
            drive.wait()
            drive.run()
            if drive.stop is not None:
                self._error = drive.stop

    def _next(self, action: ArrayLike | None = None) -> _Observed | None:
        """Give an action and wait for the next tick; None when the drive is over.

        An exception here stops the rover.
        """
        try:
            if action is not None:
                v, omega = np.clip(
                    np.asarray(action, np.float64).reshape(2), ACTIONS.low, ACTIONS.high
                ).tolist()
                self._handover.actions.put((v, omega))
            return self._handover.observed.get()
        except BaseException:
            self.close()
            raise

    def _ended(self) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        drive = self._handover.drive
        self.close()
        if drive is None or drive.estimate is None or self._error is not drive.stop:
            raise self._error or RoverNcpError("the drive ended before its first tick")
        stop, pose, ticks = drive.stop, drive.estimate.pose, self.course.ticks
        signal = self.course.start_signal(TICK_S * drive.keeper.index)
        reference = self._reference.tick(drive.keeper.index) if self._reference else None
        values = self._interface.observe(pose, signal, reference)
        gain = 0.0 if stop else self._reward(self._tick, ticks, pose)
        info = {
            "time_s": TICK_S * drive.keeper.index,
            "verdict": drive.verdict.words.value if drive.verdict else None,
            "reason": drive.reason,
            "stopped_by": stop.rule if stop else None,
        }
        return np.array(values, np.float64), gain, stop is None, stop is not None, info

    def _reward(self, begin: int, end: int, pose: Pose) -> float:
        """Return the reward for the checkpoints due in the ticks from ``begin`` to before ``end``."""
        due = [number for number in self._due[begin:end].tolist() if number >= 0]
        return sum(reward(pose, self.course.checkpoints[number].pose) for number in due)


def _not_recorded(_message: Recorded) -> None:
    """Drop a message: the environment records nothing."""


gymnasium.register(id=ENV_ID, entry_point="deploy.env:RoverEnv")
