"""Behaviour cloning of a law by gradient through an agent's solver, then CMA-ES from the clone.

A law drives the first episodes, the agent itself the later ones, and the law says what it should have done in
each of them (DAgger; Ross et al., 2011). Adam descends the mean squared difference over all episodes so far,
by backpropagation through windows of them. The best agent of all rounds goes on to the evolution, which knows
the return alone. Every step of an environment counts, those of the law and of the returns too.

mountain-car    a = 12 v: it pushes the way the car moves, so that its energy grows
parking         Kanayama's law, within the paper's limits, on the nominal course and on disturbed ones
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch

from rover_ncp.circuit.policy import Policy, course_policy
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.circuit.tap_withdrawal import tap_withdrawal_circuit
from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import TICK_S, load_course
from rover_ncp.course.reference import plan_reference
from sim.learn.commander import CommanderRunner
from sim.learn.laws import LAWS, law_command, law_commander
from sim.learn.networks import Net, NetKind, net_for
from sim.learn.rollout import rollout
from sim.learn.search.base import Vector, draw_seeds
from sim.paper.agents import untuned
from sim.paper.cma_search import Search
from sim.paper.disturbance import observe_lanes, step_lanes
from sim.paper.evaluator import Evaluator, commander_for, first_states, make_plants
from sim.paper.parking import ParkingEvaluator
from sim.paper.plants.lanes import reset_plant
from sim.paper.random_search import Found, confirmed, search_generator
from sim.paper.tasks import Benchmark, Task
from sim.paper.unrolled import student_of
from sim.world.described import default_rover
from sim.world.randomization import draw_trials, load_randomization

CLONING: dict[str, Any] = {
    "rounds": 8,
    "passes": 10,
    "window": 40,
    "episodes": 8,
    "learning_rate": 0.01,
    "spread": 0.03,
    "population": 16,
    "generations": 250,
}
"""Settings, which a run records: rounds of episodes; passes over all episodes after each of them; ticks of a
window; episodes of a round; Adam's; and those of CMA-ES."""
_QUICK = {"rounds": 2, "passes": 2, "generations": 5}
_GAIN = 12.0
_TICKS = 400
"""Longest episode of mountain car that is learned from."""
_RETURN_EPISODES, _ROLLOUTS = 20, 4
"""Episodes of mountain car behind the return of a round, and behind that of a candidate."""
# Streams of random numbers; others are those of ``random_search.py`` and ``cma_search.py``.
_EPISODES, _RETURNS, _EVOLUTION = range(20, 23)


class Episodes(NamedTuple):
    """E episodes of at most T ticks, of which ``counts`` (E, T) are learned from."""

    seen: Vector
    """(E, T, inputs)."""
    asked: Vector
    """(E, T, outputs) of the law."""
    counts: Vector
    steps: int


class Lesson(NamedTuple):
    """What a task gives to a training."""

    start: Vector
    """(P,) the search's own."""
    collect: Callable[[int, Vector | None], Episodes]
    """Drive the episodes of a round by parameters (P,), or by the law."""
    judge: Callable[[int, Vector], float]
    """Return of parameters (P,), as a round shows it; minus infinity is added where it does not park."""
    values: Callable[[int, Vector], Vector]
    """What the evolution climbs: (k,) of the candidates (k, P) of a generation."""
    evaluator: Any
    """It counts the steps."""


def clone(task: Task, agent: Policy | Net, seed: int, *, quick: bool) -> tuple[Any, ...]:
    """Train an agent; return what was found, the steps, and the settings to record."""
    torch.set_num_threads(1)
    settings = CLONING | (_QUICK if quick else {})
    lesson = (_car_lesson if isinstance(task, Benchmark) else _parking_lesson)(task, agent, seed)
    scale = _scale(task)
    student = student_of(agent, lesson.start)
    optimizer = torch.optim.Adam(student.parameters, lr=settings["learning_rate"])
    best, value = lesson.start, lesson.judge(0, lesson.start)
    curve = [(lesson.evaluator.steps, value)]
    data: list[Episodes] = []
    for number in range(settings["rounds"]):
        data.append(lesson.collect(number, student.vector() if number else None))
        lesson.evaluator.steps += data[-1].steps
        descend(student, optimizer, joined(data), scale, settings)
        vector = student.vector()
        found = lesson.judge(number + 1, vector)
        if found > value:
            best, value = vector, found
            curve.append((lesson.evaluator.steps, value))
    settings |= {"law_steps": data[0].steps, "cloned_steps": lesson.evaluator.steps, "cloned": value}
    search = Search(
        agent, best, int(draw_seeds(seed, (_EVOLUTION,), 1)[0]), settings=settings, separable=False
    )
    ended = "steps"
    for number in range(settings["generations"]):
        if value >= task.enough:
            ended = "enough"
            break
        vectors = search.ask()
        values = lesson.values(number, vectors)
        search.tell(values)
        candidate = vectors[int(values.argmax())]
        if values.max() > value and (found := lesson.judge(-1 - number, candidate)) > value:
            best, value = candidate, found
            curve.append((lesson.evaluator.steps, value))
    evaluations = settings["rounds"] + settings["generations"] * settings["population"]
    return Found(best, evaluations, tuple(curve), ended), lesson.evaluator.steps, settings


def descend(student: Any, optimizer: Any, data: Episodes, scale: Vector, settings: dict[str, Any]) -> None:
    """Pass over all episodes, one step of Adam for each window of them."""
    seen, asked, counts = map(torch.from_numpy, (data.seen, data.asked / scale, data.counts))
    for _ in range(settings["passes"]):
        state = None
        for first in range(0, seen.shape[1], settings["window"]):
            part = slice(first, first + settings["window"])
            z, state = student.outputs(seen[:, part], state)
            weight = counts[:, part, None]
            loss = (weight * (z - asked[:, part]) ** 2).sum() / weight.sum().clamp(min=1.0)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            student.vector()
            state = state.detach()


def joined(data: list[Episodes]) -> Episodes:
    """Return all episodes as one, the shorter ones filled up with ticks that do not count."""
    ticks = max(part.seen.shape[1] for part in data)

    def filled(values: Vector) -> Vector:
        missing = ticks - values.shape[1]
        return np.pad(values, [(0, 0), (0, missing), *[(0, 0)] * (values.ndim - 2)])

    columns = zip(*(part[:3] for part in data), strict=True)
    arrays = (np.concatenate([filled(values) for values in column]) for column in columns)
    return Episodes(*arrays, sum(part.steps for part in data))


def _scale(task: Task) -> Vector:
    """Return the largest size of each output (outputs,)."""
    net = net_for(task.policy(task.circuit()), NetKind.MLP)
    return np.maximum(np.array(net.high), -np.array(net.low))


def _car_lesson(task: Benchmark, agent: Policy | Net, seed: int) -> Lesson:
    evaluator = Evaluator(task, agent)
    commander, (inputs, outputs) = commander_for(agent)

    def collect(number: int, vector: Vector | None) -> Episodes:
        count = CLONING["episodes"]
        plants, pool = make_plants(task, count)
        arrays = commander.allocate(count)
        for lane, start in enumerate(first_states(task, draw_seeds(seed, (_EPISODES, number), count))):
            if vector is not None:
                commander.start_lane(arrays, lane, vector)
            reset_plant(plants, lane, start)
        running, totals = np.ones(count, np.bool_), np.zeros(count)
        seen, commands = np.zeros((inputs, count)), np.zeros((outputs, count))
        rows, counts = [], []
        while running.any() and len(rows) < _TICKS:
            observe_lanes(plants, seen)
            rows.append(seen.T.copy())
            counts.append(running.astype(np.float64))
            if vector is None:
                commands[:] = np.clip(_GAIN * seen[1:], -1.0, 1.0)
            else:
                commander.tick_lanes(arrays, seen, commands)
            step_lanes(plants, commands, running, totals)
        del pool
        shown, ran = np.array(rows).transpose(1, 0, 2), np.array(counts).T
        return Episodes(shown, np.clip(_GAIN * shown[:, :, 1:], -1.0, 1.0), ran, int(ran.sum()))

    def judge(number: int, vector: Vector) -> float:
        seeds = draw_seeds(seed, (_RETURNS, number % 2**32), _RETURN_EPISODES)
        value = float(evaluator.returns(vector[None], seeds).mean())
        return value if value < task.enough else confirmed(evaluator, vector, seed, number % 2**32)

    def values(number: int, vectors: Vector) -> Vector:
        seeds = draw_seeds(seed, (_EVOLUTION, number), _ROLLOUTS)
        means: Vector = evaluator.returns(vectors, seeds).mean(axis=1)
        return means

    return Lesson(untuned(agent, search_generator(seed), 1)[0], collect, judge, values, evaluator)


def _parking_lesson(task: Task, agent: Policy | Net, seed: int) -> Lesson:
    evaluator, course = ParkingEvaluator(task, agent), load_course("parking")
    reference, model, law = plan_reference(course), default_rover(), LAWS["kanayama"]
    untuned = task.policy(task.circuit())
    limits = _scale(task)
    following = course_policy(tap_withdrawal_circuit())
    following = replace(following, motors=following.motors.model_copy(update={"limits": tuple(limits)}))
    own, theirs = RoverInterface(untuned), RoverInterface(following)
    teacher = CommanderRunner(law_commander(law, following), np.array(law.tuned))
    commander, _ = commander_for(agent)

    def collect(number: int, vector: Vector | None) -> Episodes:
        trials = draw_trials(
            load_randomization("mild"),
            model,
            seed,
            count=CLONING["episodes"],
            ticks=course.ticks,
            first=number * CLONING["episodes"],
        )
        runner = teacher if vector is None else CommanderRunner(commander, vector)
        seen, asked = [], []
        for row in range(-1, CLONING["episodes"] - 1):
            runner.reset()
            given: dict[str, Any] = {} if row < 0 else {"trials": trials, "row": row}
            driven = rollout(following if vector is None else untuned, course, model, runner=runner, **given)
            poses = [Pose(*pose) for pose in driven.seen]
            signals = [course.start_signal(TICK_S * tick) for tick in range(course.ticks)]
            ticks = zip(poses, signals, strict=True)
            # The first tick is the circuit's warm-up.
            seen.append([own.observe(poses[0], 0.0, None), *(own.observe(*tick, None) for tick in ticks)])
            asked.append(
                [
                    law_command(
                        law.number,
                        np.array(law.tuned),
                        np.array(theirs.observe(pose, 0.0, reference.tick(k))),
                    )
                    for k, pose in enumerate(poses)
                ]
            )
        wanted = np.clip(np.array(asked), [0.0, -limits[1]], limits)
        wanted = np.concatenate([wanted[:, :1], wanted], axis=1)
        counts = np.ones(wanted.shape[:2])
        counts[:, 0] = 0.0
        return Episodes(np.array(seen), wanted, counts, len(asked) * course.ticks)

    def judge(number: int, vector: Vector) -> float:
        evaluator.steps += course.ticks
        total, parked = evaluator.outcome(vector)
        return total if parked else min(total, task.success - 1.0)

    def values(number: int, vectors: Vector) -> Vector:
        return evaluator.traces(vectors)[1]

    start = agent.parameters() if isinstance(agent, Policy) else agent.start(search_generator(seed))
    return Lesson(start, collect, judge, values, evaluator)
