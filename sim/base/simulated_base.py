"""What every simulated base is: a drive train with a trial's errors and with faults, and time passed in."""

from abc import ABC, abstractmethod
from collections.abc import Callable

from rover_ncp.robot.description import RobotDescription
from sim.base.drive_train import DriveTrain
from sim.base.faults import Fault, Faults
from sim.base.trial import BaseTrial
from sim.world.randomization import nominal_trials
from sim.world.rover import SUBSTEP_S, Rover


class SimulatedBase(ABC):
    """A base on a rover, from where that stands at ``start_s``, on the clock of all its times, s."""

    def __init__(
        self,
        robot: RobotDescription,
        rover: Rover,
        faults: Faults | None,
        start_s: float,
        trial: BaseTrial | None,
    ) -> None:
        self.robot = robot
        self._trial = trial or BaseTrial(nominal_trials(rover.model, ticks=1))
        self.drive = DriveTrain(robot, rover, self._trial)
        self.observe: Callable[[float], None] | None = None
        """Called after each substep with its time in s."""
        self._faults = Faults() if faults is None else faults
        self._start_s, self._substeps = start_s, 0
        self._first_s: float | None = None
        """When a client first let it drive: faults and the trial count from then."""
        self._was_reset = False

    @property
    def now(self) -> float:
        """The time up to which the rover has moved, s."""
        return self._start_s + self._substeps * SUBSTEP_S

    @property
    @abstractmethod
    def ignored(self) -> int:
        """Number of commands that it could not use."""

    @property
    @abstractmethod
    def due_s(self) -> float:
        """When the base next sends something by itself, or later."""

    def advance(self, now: float) -> None:
        """Let time pass until ``now``."""
        while self.now + SUBSTEP_S <= now + 1e-9:
            self._substep()

    def inject(self, fault: Fault) -> None:
        """Add a fault from now on; its times count from now, if a client ever let the base drive."""
        self._faults.add(fault, self._driven_s)

    @abstractmethod
    def _substep(self) -> None:
        """Advance by `SUBSTEP_S`."""

    @property
    def _driven_s(self) -> float | None:
        """Seconds since a client first let it drive."""
        return None if self._first_s is None else self.now - self._first_s

    def _fault(self, name: str) -> float | None:
        return self._faults.value(name, self._driven_s) if self._faults else None

    def _reset_begins(self) -> bool:
        was_reset, self._was_reset = self._was_reset, self._fault("reset") is not None
        return self._was_reset and not was_reset

    def _begin_tick(self, tick: int) -> None:
        """Begin a tick of the trial."""
        self._trial.tick = tick
        if push := self._trial.push:
            self.drive.rover.push(push)
