"""Episodes of many agents in the lanes of one kernel, without a pause.

Run batch after batch, lanes would stand idle until the last episode of a batch ends, the longer the more of
the others lost their race. Here a lane that falls free takes the next episode that waits, whosever it is,
and an agent gets its answer as soon as its own episodes are done, while those of the others go on. What an
episode gives depends neither on its lane nor on its company, so this changes the speed and nothing else.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.compiled import Program, fill_lane
from rover_ncp.circuit.solver import tick_lanes
from rover_ncp.kernels.jit import borrowed, kernel
from sim.learn.episode import IDLE, RESULTS, Lanes, Queue, Tasks, finish_tick, pass_commands, start_episode
from sim.learn.evaluator import Evaluator
from sim.learn.flow import Answer
from sim.learn.search.base import Vector
from sim.world.fleet import FleetArrays, advance, read_poses, send
from sim.world.randomization import Trials

IntArray = NDArray[np.int64]

LANES = 8
"""One vector; with more, lanes stand idle while agents wait for their last episode."""
_IN_FLIGHT = 12
"""Some wait, so that a lane that falls free need not."""
_LEAST_ROOM, _ROOM = 8, 64


class Slots(NamedTuple):
    """The places of a stream's queue: S in all, as many for each of A agents, agent by agent."""

    waiting: IntArray
    """(S,) ring of places whose episodes wait for a lane."""
    ring: IntArray
    """(2,) where the ring begins, and how many wait."""
    left: IntArray
    """(A,) episodes that have not ended."""
    before: IntArray
    """(L,) work: the lanes' episodes before a tick."""


@kernel
def enqueue(  # noqa: PLR0917  # a whole queue would take longer to hand over than to fill
    vectors: Vector,
    stop_below: Vector,
    misses: Vector,
    slots: Slots,
    agent: int,
    added: Vector,
    to_beat: Vector,
) -> None:
    """Let an agent's candidates (n, P) wait."""
    waiting, ring, left, _ = slots
    first = agent * (len(waiting) // len(left))
    for i in range(len(added)):
        place = first + i
        vectors[place] = added[i]
        stop_below[place] = to_beat[i]
        misses[place] = 0.0
        waiting[(ring[0] + ring[1]) % len(waiting)] = place
        ring[1] += 1
    left[agent] = len(added)


@kernel
def run_until_answer(  # noqa: PLR0917  # as run_episodes
    program: Program,
    signal_at: IntArray,
    tasks: Tasks,
    trials: Trials,
    lanes: Lanes,
    fleet: FleetArrays,
    queue: Queue,
    slots: Slots,
) -> None:
    """Run episodes until all of some agent have ended and a lane wants work, or until none is left."""
    program, tasks, trials = borrowed(program), borrowed(tasks), borrowed(trials)
    lanes, fleet, queue = borrowed(lanes), borrowed(fleet), borrowed(queue)
    waiting, ring, left, before = slots
    episodes = lanes.episode
    room = len(waiting) // len(left)
    running = 0
    for lane in range(len(episodes)):
        running += episodes[lane] != IDLE
    answered = 0
    while True:
        for lane in range(len(episodes)):
            if episodes[lane] == IDLE and ring[1] > 0:
                place = waiting[ring[0]]
                ring[0] = (ring[0] + 1) % len(waiting)
                ring[1] -= 1
                fill_lane(program, lanes.parameters, lane, queue.vectors[queue.vector[place]])
                episodes[lane] = place
                start_episode(signal_at, tasks, trials, lanes, fleet, queue, lane)
                running += 1
        if running == 0:
            return
        before[:] = episodes
        tick_lanes(program, lanes.parameters, lanes.potentials, lanes.observations, lanes.commands)
        pass_commands(trials, lanes, queue)
        send(fleet, lanes.driven)
        advance(fleet)
        read_poses(fleet, lanes.poses)
        if finish_tick(signal_at, tasks, trials, lanes, fleet, queue) > 0:
            for lane in range(len(episodes)):
                if episodes[lane] != before[lane]:
                    running -= 1
                    agent = before[lane] // room
                    left[agent] -= 1
                    answered += left[agent] == 0
        if answered > 0 and ring[1] == 0 and running < len(episodes):
            return


class Stream:
    """A flow of episodes of the first trial on the first course of an engine, for so many agents.

    ``room`` is how many candidates an agent may submit at once, ``enough`` how many keep all lanes busy.
    """

    def __init__(self, engine: Evaluator, agents: int) -> None:
        self.room = max(_LEAST_ROOM, -(-_ROOM // agents))
        self.enough = -(-_IN_FLIGHT // agents)
        self._engine = engine
        self._fleet, self._lanes = engine.build_team(LANES)
        places = agents * self.room
        zeros = np.zeros(places, np.int64)
        self._queue = Queue(
            vectors=np.zeros((places, engine.policy.layout().size)),
            vector=np.arange(places),
            task=zeros,
            trial=zeros,
            stop_below=np.zeros(places),
            results=np.zeros((places, RESULTS)),
            misses=np.zeros((places, *engine.checkpoints)),
        )
        self._slots = Slots(
            waiting=np.zeros(places, np.int64),
            ring=np.zeros(2, np.int64),
            left=np.zeros(agents, np.int64),
            before=np.full(LANES, IDLE),
        )
        self._submitted = [0] * agents

    def submit(self, agent: int, vectors: Vector, to_beat: Vector, keys: Sequence[tuple[int, ...]]) -> None:
        """Let the episodes of candidates (n, P), n <= room, wait for lanes; the agent has none that do."""
        count, queue, slots = len(vectors), self._queue, self._slots
        if self._submitted[agent] or not 0 < count <= self.room:
            raise ValueError(f"agent {agent} cannot submit {count} candidates now")
        enqueue(queue.vectors, queue.stop_below, queue.misses, slots, agent, vectors, to_beat)
        self._submitted[agent] = count

    def collect(self) -> list[Answer]:
        """Return the results of all candidates of one agent or more; nothing if no candidates wait."""
        run_until_answer(*self._engine.setting, self._lanes, self._fleet.arrays, self._queue, self._slots)
        answers = []
        for agent, left in enumerate(self._slots.left.tolist()):
            count = self._submitted[agent]
            if left or not count:
                continue
            places = slice(agent * self.room, agent * self.room + count)
            self._submitted[agent] = 0
            answers.append(Answer(agent, self._queue.results[places, 0], self._queue.misses[places, None]))
        return answers
