"""Whole episodes of many candidates in one kernel: lanes of circuits, each with a rover of a fleet.

Candidates wait in a queue for a free lane. A lane runs its candidate's episode on a clock of its own, and
takes the next candidate when the episode ends or, in a race, is lost; so all lanes stay busy, and what a
candidate returns depends neither on its lane nor on its company. ``rollout.py`` says what an episode is; the
tests hold the two together to the last bit.

A return only falls, as every reward is negative: a candidate that is already worse than what it must beat
has lost, and stopping it changes no decision.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rover_ncp.circuit.circuit import RESTING_MV
from rover_ncp.circuit.lanes import allocate_lanes, make_program, resting_potentials
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.program import LaneParameters, Program
from rover_ncp.circuit.solver import fill_lane, tick_lanes
from rover_ncp.core.course import TICK_S, Course
from rover_ncp.jit import kernel
from sim.learn.rollout import START, require_driver
from sim.world.fleet import ROVERS_PER_BAY, Fleet, FleetArrays, advance, place, read_poses, send, wrapped
from sim.world.rover import RoverModel, require_free_start
from sim.world.scoring import due_checkpoints

__all__ = ["Engine"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MOST_LANES = 32
"""More gain nothing: all lanes' numbers should stay in a core's first cache."""
RACERS_PER_LANE = 6
IDLE = -1
WARMING_UP = -1


class _Task(NamedTuple):
    """A course as the kernel sees it; T ticks."""

    start: FloatArray
    """(3,) pose."""
    signal: FloatArray
    """(T + 1,) start signal at the start of each tick."""
    due: IntArray
    """(T,) checkpoint judged at the end of each tick, or -1."""
    checkpoints: FloatArray
    """(checkpoints, 3) poses."""


class _Lanes(NamedTuple):
    """The state of L lanes."""

    parameters: LaneParameters
    potentials: FloatArray
    observations: FloatArray
    commands: FloatArray
    poses: FloatArray
    """(n, L), (4, L), (2, L), (3, L)."""
    candidate: IntArray
    """(L,) or IDLE."""
    tick: IntArray
    """(L,) or WARMING_UP."""
    total: FloatArray
    """(L,) running return."""


class _Queue(NamedTuple):
    """The candidates of one call, k of them, and what becomes of them."""

    vectors: FloatArray
    """(k, P)."""
    stop_below: FloatArray
    returns: FloatArray
    """(k,) each."""


class Engine:
    """Scores parameter vectors of one kind of policy on one course. Not for several threads at once.

    Raises ConfigError when the policy cannot drive or the course's start is blocked.
    """

    def __init__(self, policy: Policy, course: Course, model: RoverModel | None = None) -> None:
        require_driver(policy)
        self.policy, self.course, self.model = policy, course, model or RoverModel()
        require_free_start(self.model, course)
        self._program = make_program(policy)
        self._task = _Task(
            start=np.array(START),
            signal=np.array([course.start_signal(TICK_S * tick) for tick in range(course.ticks + 1)]),
            due=due_checkpoints(course),
            checkpoints=np.array([point.pose for point in course.checkpoints]),
        )
        self._teams: dict[int, tuple[Fleet, _Lanes]] = {}

    def returns(self, vectors: ArrayLike, stop_below: ArrayLike | None = None) -> FloatArray:
        """Return the returns (k,) of parameter vectors (k, P), which must lie in bounds.

        With ``stop_below`` (k,), an episode ends as soon as its running return is below its threshold; what
        is returned for it is then below the threshold, too, and at least what the whole episode would give.
        """
        vectors = np.ascontiguousarray(np.atleast_2d(np.asarray(vectors, np.float64)))
        count = len(vectors)
        stop = np.full(count, -np.inf) if stop_below is None else np.array(stop_below, np.float64)
        if stop.shape != (count,):
            raise ValueError(f"stop_below needs one threshold for each of {count} vectors")
        if not count:
            return np.zeros(0)
        fleet, lanes = self._team(_width(count, race=bool((stop > -np.inf).any())))
        queue = _Queue(vectors, stop, np.zeros(count))
        _run(self._program, self._task, lanes, fleet.arrays, queue)
        return queue.returns

    def _team(self, width: int) -> tuple[Fleet, _Lanes]:
        """Return lanes and rovers of a width, built once."""
        if width not in self._teams:
            lanes = _Lanes(
                parameters=allocate_lanes(self._program, self.policy, width),
                potentials=resting_potentials(self.policy, width),
                observations=np.zeros((4, width)),
                commands=np.zeros((2, width)),
                poses=np.zeros((3, width)),
                candidate=np.full(width, IDLE),
                tick=np.zeros(width, np.int64),
                total=np.zeros(width),
            )
            self._teams[width] = Fleet([self.model] * width, self.course.obstacles), lanes
        return self._teams[width]


def _width(count: int, race: bool) -> int:
    """Return how many lanes serve so many candidates, in whole bays.

    Episodes of the same length go in as few rounds as can be, evenly full. In a race they end at all times,
    so fewer lanes with a queue behind them do more than many that stand idle at the end.
    """
    most = min(MOST_LANES, count // RACERS_PER_LANE) if race else MOST_LANES
    rounds = -(-count // max(most, ROVERS_PER_BAY))
    return -(-count // (rounds * ROVERS_PER_BAY)) * ROVERS_PER_BAY


@kernel
def _run(program: Program, task: _Task, lanes: _Lanes, fleet: FleetArrays, queue: _Queue) -> None:
    """Run the episodes of all candidates in the queue."""
    waiting, running = 0, 0
    lanes.candidate[:] = IDLE
    while True:
        for lane in range(len(lanes.candidate)):
            if lanes.candidate[lane] == IDLE and waiting < len(queue.returns):
                fill_lane(program, lanes.parameters, lane, queue.vectors[waiting])
                _start(task, lanes, fleet, lane)
                lanes.candidate[lane] = waiting
                waiting += 1
                running += 1
        if running == 0:
            return
        tick_lanes(program, lanes.parameters, lanes.potentials, lanes.observations, lanes.commands)
        _hold_back(lanes)
        send(fleet, lanes.commands)
        advance(fleet)
        read_poses(fleet, lanes.poses)
        running -= _finish_tick(task, lanes, fleet, queue)


@kernel
def _start(task: _Task, lanes: _Lanes, fleet: FleetArrays, lane: int) -> None:
    """Begin an episode: neurons at rest, the rover at the start, no start signal."""
    lanes.potentials[:, lane] = RESTING_MV
    lanes.tick[lane] = WARMING_UP
    lanes.total[lane] = 0.0
    place(fleet, lane, task.start[0], task.start[1], task.start[2])
    lanes.observations[:3, lane] = task.start
    lanes.observations[3, lane] = 0.0


@kernel
def _hold_back(lanes: _Lanes) -> None:
    """Keep the rovers still whose circuit is warming up, or whose lane is idle."""
    commands, candidate, tick = lanes.commands, lanes.candidate, lanes.tick
    for lane in range(len(candidate)):
        if candidate[lane] == IDLE or tick[lane] == WARMING_UP:
            commands[0, lane] = commands[1, lane] = 0.0


@kernel
def _finish_tick(task: _Task, lanes: _Lanes, fleet: FleetArrays, queue: _Queue) -> int:
    """Judge what a tick led to, and observe; return how many episodes ended."""
    # Local names: numba counts references whenever an array is taken out of a tuple.
    candidate, tick, total, poses = lanes.candidate, lanes.tick, lanes.total, lanes.poses
    observations, start, signal, due, checkpoints = (
        lanes.observations,
        task.start,
        task.signal,
        task.due,
        task.checkpoints,
    )
    stop_below = queue.stop_below
    ended = 0
    for lane in range(len(candidate)):
        if candidate[lane] == IDLE:
            continue
        now = tick[lane]
        if now == WARMING_UP:
            # The rover stood still, but for what the last contact of its last episode left to correct.
            place(fleet, lane, start[0], start[1], start[2])
            poses[:, lane] = start
        elif due[now] >= 0:
            target = due[now]
            dx, dy = poses[0, lane] - checkpoints[target, 0], poses[1, lane] - checkpoints[target, 1]
            dtheta = wrapped(poses[2, lane] - checkpoints[target, 2])
            total[lane] -= dx * dx + dy * dy + dtheta * dtheta
        tick[lane] = now + 1
        observations[:3, lane] = poses[:, lane]
        observations[3, lane] = signal[now + 1]
        if now + 1 == len(due) or total[lane] < stop_below[candidate[lane]]:
            queue.returns[candidate[lane]] = total[lane]
            candidate[lane] = IDLE
            ended += 1
    return ended
