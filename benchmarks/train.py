"""How fast the training engine is, and where its time goes.

    python -m benchmarks.train [--iterations 2500]

prints one JSON object: episodes and iterations per second on one core and on all, the evaluator's share of
an iteration, and what a substep of a lane costs by the number of lanes.

Speeds are counted in CPU time, so that the machine's other work shows as little as possible. Where processes
share the work, a round lasts as long as the slowest of them.
"""

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from rover_ncp.circuit.compiled import allocate_lanes, make_program, resting_potentials
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.solver import tick_lanes
from rover_ncp.core.streams import Domain, random_stream
from rover_ncp.kernels.jit import kernel
from sim.learn.agents import AgentState, Batch, Plan, split
from sim.learn.engine.evaluator import Answer, Evaluator, Stream
from sim.learn.record import Task, TrainSettings, resolve_task
from sim.learn.search.strategies import SearchName
from sim.learn.train import training_plan
from sim.learn.workers import ProcessPool, available_processes, made_in_each_process
from sim.world.described import default_rover
from sim.world.fleet import Fleet, advance, send
from sim.world.rover import SUBSTEPS

LANES = tuple(2**n for n in range(13))
"""1 to 4096."""
_REPEATS = 5
_EPISODES = 72
_AGENTS = 12
_WARM_ITERATIONS = 100
_LANE_TICKS = 65_536
_NS = 1e9


def bench_train(iterations: int, say: Callable[[str], None]) -> dict[str, Any]:
    """Measure everything on the parking course; ``iterations`` of 12 agents for each strategy and speed."""
    settings = {str(name): TrainSettings.model_validate({"search": name}) for name in SearchName}
    task = resolve_task(settings["gauss-newton"])
    plans = {name: training_plan(each, task) for name, each in settings.items()}
    cores = available_processes()
    fields: dict[str, Any] = {"cores": cores}
    fields |= _parts(task)
    say("{episodes_per_s:.0f} episodes/s".format(**fields))
    for row in fields["cost_by_lanes"]:
        say("{lanes} lanes: circuit {circuit_ns:.0f} ns, physics {physics_ns:.0f} ns a substep".format(**row))
    speeds: dict[str, Any] = {}
    for name, plan in plans.items():
        one, in_evaluator = _iterations_per_cpu_s(plan, task, iterations)
        every, wall = _iterations_on_all_cores(plan, iterations, cores)
        speeds[name] = {
            "one_core": one,  #: per second of CPU time
            "all_cores": every,  #: the same; all last as long as the slowest process
            "ratio": every / one,  #: of the two
            "all_cores_wall": wall,  #: per second of wall time
            "evaluator_share": in_evaluator,  #: of an iteration's CPU time
        }
        say(f"{name}: {one:.0f} iterations/s and core, {every / one:.2f} times that on {cores} cores")
    fields["iterations_per_s"] = speeds
    return fields


def _parts(task: Task) -> dict[str, Any]:
    """Measure whole episodes and their parts, so that they can be compared: all in turn, again and again."""
    engine, vectors = Evaluator(task.policy, task.course), _candidates(task.policy, _EPISODES)
    calls: dict[str, Callable[[], object]] = {"episodes": lambda: engine.returns(vectors)}
    fleets = [Fleet([default_rover()] * lanes) for lanes in LANES]  # kept: their arrays hold but addresses
    for lanes, fleet in zip(LANES, fleets, strict=True):
        commands = np.full((2, len(fleet.bodies)), 0.1)
        calls[f"circuit {lanes}"] = partial(_tick_circuits, *_circuits(task, lanes), _ticks(lanes))
        calls[f"physics {lanes}"] = partial(_tick_rovers, fleet.arrays, commands, _ticks(lanes))
    cpu_s = median_cpu_s(calls)
    by_lanes = [
        {"lanes": lanes}
        | {
            #: CPU time of a substep and lane
            f"{name}_ns": cpu_s[f"{name} {lanes}"] * _NS / (lanes * _ticks(lanes) * SUBSTEPS)
            for name in ("circuit", "physics")
        }
        for lanes in LANES
    ]
    return {
        "episodes_per_s": len(vectors) / cpu_s["episodes"],  #: of one core, per second of CPU time
        "cost_by_lanes": by_lanes,  #: for 1 to 4096 lanes
    }


def _candidates(policy: Policy, count: int) -> np.ndarray:
    layout = policy.layout()
    noise = random_stream(0, Domain.STUDY).normal(size=(count, layout.size))
    vectors = policy.parameters() + 0.05 * noise * (layout.upper - layout.lower)
    return np.clip(vectors, layout.lower, layout.upper)


def median_cpu_s(calls: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Return the median CPU time of each call after a warm-up call; calls alternate, as load varies."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for repeat in range(_REPEATS + 1):
        for name, run in calls.items():
            began = time.process_time()
            run()
            if repeat:
                times[name].append(time.process_time() - began)
    return {name: statistics.median(each) for name, each in times.items()}


class _TimedEvaluator(Evaluator):
    """An evaluator that counts the CPU time of its streams."""

    cpu_s = 0.0

    def stream(self, agents: int) -> Stream:
        """Return a stream whose answers are timed."""
        stream = super().stream(agents)
        collect = stream.collect

        def timed() -> list[Answer]:
            began = time.process_time()
            answers = collect()
            self.cpu_s += time.process_time() - began
            return answers

        stream.collect = timed
        return stream


def _advance(batch: Batch, agents: Sequence[AgentState], iterations: int) -> tuple[list[AgentState], float]:
    """Return agents after so many iterations, and the CPU time that this took."""
    began = time.process_time()
    done = batch.advance(agents, [iterations])
    return [states[-1] for states in done], time.process_time() - began


def _iterations_per_cpu_s(plan: Plan, task: Task, iterations: int) -> tuple[float, float]:
    """Return the speed, and the evaluator's share of the time.

    The same iterations run twice and the second run counts. Descents begin after the warm-up, and their
    kernels are compiled or loaded on their first calls.
    """
    evaluator = _TimedEvaluator(task.policy, task.course)
    batch = Batch(replace(plan, build_evaluator=lambda: evaluator))
    agents, _ = _advance(batch, [AgentState(number) for number in range(_AGENTS)], _WARM_ITERATIONS)
    for _ in range(2):
        evaluator.cpu_s = 0.0
        _, cpu_s = _advance(batch, agents, _WARM_ITERATIONS + iterations)
    return _AGENTS * iterations / cpu_s, evaluator.cpu_s / cpu_s


def _advance_in_process(plan: Plan) -> Callable[..., tuple[list[AgentState], float]]:
    return partial(_advance, Batch(plan))


def _iterations_on_all_cores(plan: Plan, iterations: int, cores: int) -> tuple[float, float]:
    """Return the iterations per second of CPU time, as it would be on idle cores, and of wall time."""
    agents = [AgentState(number) for number in range(_AGENTS)]
    advance = made_in_each_process(partial(_advance_in_process, plan))
    with ProcessPool(cores) as workers:

        def run(agents: Sequence[AgentState], until: int) -> tuple[list[AgentState], float]:
            futures = [workers.submit(advance, group, until) for group in split(agents, cores)]
            parts = [future.result() for future in futures]
            return [agent for part, _ in parts for agent in part], max(cpu_s for _, cpu_s in parts)

        warm, _ = run(agents, _WARM_ITERATIONS)
        for _ in range(2):  # as on one core
            began = time.monotonic()
            _, cpu_s = run(warm, _WARM_ITERATIONS + iterations)
            wall_s = time.monotonic() - began
        return _AGENTS * iterations / cpu_s, _AGENTS * iterations / wall_s


def _ticks(lanes: int) -> int:
    """Return how many ticks take long enough to be timed."""
    return _LANE_TICKS // lanes


def _circuits(task: Task, lanes: int) -> tuple[Any, ...]:
    program = make_program(task.policy)
    parameters = allocate_lanes(program, task.policy, lanes)
    potentials = resting_potentials(task.policy, lanes)
    observations = np.full((len(task.policy.sensing.inputs), lanes), 0.3)
    return program, parameters, potentials, observations, np.zeros((2, lanes))


@kernel
def _tick_circuits(program, parameters, potentials, observations, commands, ticks):  # noqa: PLR0917  # numba's own types
    for _ in range(ticks):
        tick_lanes(program, parameters, potentials, observations, commands)


@kernel
def _tick_rovers(fleet, commands, ticks):  # numba's own types
    for _ in range(ticks):
        send(fleet, commands)
        advance(fleet)


def main() -> None:
    """Measure from the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.train")
    parser.add_argument("--iterations", type=int, default=2500, help="of each agent")
    given = parser.parse_args()
    print(json.dumps(bench_train(given.iterations, lambda line: print(line, file=sys.stderr)), indent=2))


if __name__ == "__main__":
    main()
