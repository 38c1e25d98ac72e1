"""The parking course as a Gymnasium environment, ``rover_ncp/RoverParking-v0``.

Importing this module registers it. Gymnasium 1 looks for no plugins, but imports a module that an id names:

    gymnasium.make("sim.world.env:rover_ncp/RoverParking-v0")
"""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from rover_ncp.course.course import TICK_S, Course, load_course
from rover_ncp.course.reference import plan_reference
from rover_ncp.course.signals import SIGNALS, needs_reference, signals
from rover_ncp.course.spaces import ACTIONS, observation_space
from sim.world.described import default_rover
from sim.world.episode import Episode
from sim.world.pymunk_rover import PymunkRover
from sim.world.randomization import nominal_trials
from sim.world.rover import RoverModel

ENV_ID = "rover_ncp/RoverParking-v0"

FloatArray = NDArray[np.float64]


class RoverParkingEnv(gymnasium.Env[FloatArray, FloatArray]):
    """Drive a rover through the checkpoints of a course, each at its time.

    Observation, ``Box(float64)``: the signals that ``signals`` names (rover_ncp/course/signals.py), from the
    true pose. By default the pose in the course's frame and the start signal:

    | index | quantity        | min   | max  | unit |
    |-------|-----------------|-------|------|------|
    | 0     | x               | -1000 | 1000 | m    |
    | 1     | y               | -1000 | 1000 | m    |
    | 2     | heading θ       | -π    | π    | rad  |
    | 3     | start signal s  | 0     | 1    | 1    |

    Action, ``Box(2, float64)``: what the rover is commanded, obeyed after 0.15 s and 0.10 s. Values beyond
    the box are cut to it.

    | index | quantity        | min   | max  | unit  |
    |-------|-----------------|-------|------|-------|
    | 0     | forward speed v | -0.16 | 0.16 | m/s   |
    | 1     | rate of turn ω  | -0.18 | 0.18 | rad/s |

    A step is a control tick of 0.1 s. The reward is the paper's (``reward`` in ``rover_ncp/course``) at the
    checkpoints and 0 between; doing nothing on the paper's course returns -14.18. ``info`` holds ``time_s``
    and ``touched`` (something was touched since the reset).

    *Terminated*: the course's horizon is reached, so all there is to judge has been judged. *Truncated*:
    never by this environment; a collision ends nothing, as the rover stays where it is and pays for it.

    The environment is deterministic; a seed changes nothing.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  # gymnasium declares it so

    def __init__(
        self,
        course: str | Course = "parking",
        model: RoverModel | None = None,
        *,
        signals: Sequence[str] = (),
    ) -> None:
        self.course = course if isinstance(course, Course) else load_course(course)
        self.model = model or default_rover()
        self.signals = tuple(signals) or ("x", "y", "theta", "start")
        self.observation_space = observation_space(self.signals)
        self._places = [SIGNALS.index(name) for name in self.signals]
        self._reference = plan_reference(self.course) if needs_reference(self.signals) else None
        self.action_space = ACTIONS
        self._trials = nominal_trials(self.model, self.course.ticks)
        self._episode = Episode(self.course, self.model, self._trials)

    @property
    def rover(self) -> PymunkRover:
        """The simulated rover."""
        return self._episode.rover

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Put the rover to the origin, standing still."""
        super().reset(seed=seed, options=options)
        self._episode = Episode(self.course, self.model, self._trials)
        return self._observation(), self._info()

    def step(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Command (v, omega) and advance by a control tick."""
        v, omega = np.clip(np.asarray(action, np.float64), ACTIONS.low, ACTIONS.high)
        gain = self._episode.step(float(v), float(omega))
        return self._observation(), gain, self._episode.over, False, self._info()

    def _observation(self) -> FloatArray:
        tick = self._episode.tick
        reference = self._reference.tick(tick) if self._reference else None
        values = signals(self._episode.seen, self.course.start_signal(TICK_S * tick), reference)
        return np.array([values[place] for place in self._places])

    def _info(self) -> dict[str, Any]:
        return {"time_s": TICK_S * self._episode.tick, "touched": self._episode.touched}


gymnasium.register(id=ENV_ID, entry_point="sim.world.env:RoverParkingEnv")
