"""Scores networks on courses, on the very trials, observations and limits of a policy's circuit."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import Policy
from rover_ncp.course.course import Course
from rover_ncp.kernels.jit import borrowed, kernel
from sim.learn.episode import IDLE, Lanes, Queue, Tasks, drive_tick, start_episode
from sim.learn.evaluator import Evaluator
from sim.learn.networks import (
    Net,
    NetLanes,
    NetProgram,
    allocate_net_lanes,
    fill_net_lane,
    tick_net_lanes,
)
from sim.world.fleet import Fleet, FleetArrays
from sim.world.randomization import Trials


@kernel
def run_nets(  # noqa: PLR0917  # as run_episodes
    program: NetProgram,
    nets: NetLanes,
    signal_at: NDArray[np.int64],
    tasks: Tasks,
    trials: Trials,
    lanes: Lanes,
    fleet: FleetArrays,
    queue: Queue,
) -> None:
    """Run all episodes in the queue, as ``run_episodes`` does with circuits."""
    program, nets = borrowed(program), borrowed(nets)
    tasks, trials = borrowed(tasks), borrowed(trials)
    lanes, fleet, queue = borrowed(lanes), borrowed(fleet), borrowed(queue)
    waiting, running = 0, 0
    lanes.episode[:] = IDLE
    while True:
        for lane in range(len(lanes.episode)):
            if lanes.episode[lane] == IDLE and waiting < len(queue.results):
                fill_net_lane(program, nets, lane, queue.vectors[queue.vector[waiting]])
                lanes.episode[lane] = waiting
                start_episode(signal_at, tasks, trials, lanes, fleet, queue, lane)
                waiting += 1
                running += 1
        if running == 0:
            return
        tick_net_lanes(program, nets, lanes.observations, lanes.commands)
        running -= drive_tick(signal_at, tasks, trials, lanes, fleet, queue)


class NetEngine(Evaluator):
    """An engine whose vectors are a network's parameters. Of the policy, its mappings count."""

    def __init__(self, net: Net, policy: Policy, course: Course | Sequence[Course], **options: Any) -> None:
        """``options`` as ``Evaluator``'s: model, trials, references."""
        super().__init__(policy, course, **options)
        self._net, self._net_program = net, net.program()
        self._net_lanes: dict[int, NetLanes] = {}

    def run_queue(self, lanes: Lanes, fleet: Fleet, queue: Queue) -> None:
        """Run the episodes of a queue."""
        width = len(lanes.episode)
        if width not in self._net_lanes:
            self._net_lanes[width] = allocate_net_lanes(self._net, width)
        nets = self._net_lanes[width]
        run_nets(
            self._net_program, nets, self._signal_at, self._tasks, self._trials, lanes, fleet.arrays, queue
        )
