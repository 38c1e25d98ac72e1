"""Whole episodes in one kernel: lanes of brains, each with a plant.

Episodes wait in a queue for a free lane; what one gives depends neither on its lane nor on its company.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.kernels.jit import kernel
from sim.paper.brain import Brain, start_lane, think
from sim.paper.plants import Plants, observe, reset_plant, step_plant

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

IDLE = -1
RESULTS = 3
"""Numbers an episode ends in: Gymnasium's return, the sum of bonuses, ticks."""


class Queue(NamedTuple):
    """The E episodes of one call, and what becomes of them."""

    vectors: FloatArray
    """(V, P)."""
    vector: IntArray
    """(E,) rows of vectors."""
    starts: FloatArray
    """(E, S)."""
    horizon: int
    results: FloatArray
    """(E, RESULTS)."""


class Room(NamedTuple):
    """Work arrays of L lanes."""

    observations: FloatArray
    commands: FloatArray
    """(inputs, L) and (outputs, L)."""
    episode: IntArray
    tick: IntArray
    """(L,) each."""


@kernel
def run_episodes(brain: Brain, plants: Plants, room: Room, queue: Queue) -> None:
    """Run all episodes in the queue."""
    episodes, ticks, observations = room.episode, room.tick, room.observations
    results, horizon = queue.results, queue.horizon
    waiting, running = 0, 0
    episodes[:] = IDLE
    observations[:] = 0.0
    while True:
        for lane in range(len(episodes)):
            if episodes[lane] == IDLE and waiting < len(results):
                start_lane(brain, lane, queue.vectors[queue.vector[waiting]])
                reset_plant(plants, lane, queue.starts[waiting])
                results[waiting] = 0.0
                episodes[lane], ticks[lane] = waiting, 0
                waiting += 1
                running += 1
            if episodes[lane] != IDLE:
                observe(plants, lane, observations)
        if running == 0:
            return
        think(brain, observations, room.commands)
        for lane in range(len(episodes)):
            episode = episodes[lane]
            if episode == IDLE:
                continue
            reward, bonus, over = step_plant(plants, lane, room.commands)
            ticks[lane] += 1
            now = ticks[lane]
            results[episode, 0] += reward
            results[episode, 1] += bonus
            results[episode, 2] = now
            if over or now == horizon:
                episodes[lane] = IDLE
                running -= 1
