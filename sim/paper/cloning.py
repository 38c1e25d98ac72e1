"""Behaviour cloning of a law by gradient through an agent's solver, then CMA-ES from the clone.

A law drives the first episodes, the agent itself the later ones, and the law says what it should have done in
each of them (DAgger; Ross et al., 2011). Adam descends the mean squared difference over all episodes so far,
by backpropagation through windows of them. The best agent of all rounds goes on to the evolution, which knows
the return alone. Every step of an environment counts, those of the law and of the returns too.

mountain-car    a = 12 v: it pushes the way the car moves, so that its energy grows
parking         Kanayama's law within the paper's limits, on the course and from disturbed starts
"""

from dataclasses import replace
from typing import Any

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
from sim.paper.unrolled import Student, student_of
from sim.world.described import default_rover
from sim.world.randomization import Randomization, draw_trials

CLONING: dict[str, Any] = {
    "rounds": 8,
    "passes": 12,
    "window": 40,
    "episodes": 8,
    "learning_rate": 0.02,
    "slopes": (1.0, 0.05),
    "spread": 0.03,
    "population": 16,
    "generations": 200,
}
"""Settings, which a run records: rounds of episodes; passes over all episodes after each of them; ticks of a
window; episodes of a round; Adam's; slopes of a motor neuron beyond its ends, where most starts are, in the
first half of the rounds and in the second; and those of CMA-ES."""
_QUICK = {"rounds": 2, "passes": 2, "generations": 8}
_JUDGED_EVERY = 4
"""Generations after which the mean of the distribution is judged."""
# Streams of random numbers; others are those of ``random_search.py`` and ``cma_search.py``.
_EPISODES, _RETURNS, _EVOLUTION = range(20, 23)


def clone(task: Task, agent: Policy | Net, seed: int, *, quick: bool) -> tuple[Found, int, dict[str, Any]]:
    """Train an agent; return what was found, the steps, and the settings to record."""
    torch.set_num_threads(1)
    settings = CLONING | (_QUICK if quick else {})
    lesson = CarLesson(task, agent, seed) if isinstance(task, Benchmark) else ParkingLesson(task, agent, seed)
    student = student_of(agent, lesson.start)
    optimizer = torch.optim.Adam(student.parameters, lr=settings["learning_rate"])
    best, value = lesson.start, lesson.judge(lesson.start)
    curve, data, rounds, generations = [(lesson.evaluator.steps, value)], [], 0, 0

    def judge(vector: Vector) -> None:
        nonlocal best, value
        if (found := lesson.judge(vector)) > value:
            best, value = vector, found
            curve.append((lesson.evaluator.steps, value))

    while rounds < settings["rounds"] and value < task.enough:
        data.append(lesson.collect(rounds, student.vector() if rounds else None))
        slope = settings["slopes"][2 * rounds // settings["rounds"]]
        arrays = [torch.from_numpy(np.concatenate(parts)) for parts in zip(*data, strict=True)]
        for _ in range(settings["passes"]):
            descend(student, optimizer, arrays, settings["window"], slope)
        judge(student.vector())
        rounds += 1
    settings |= {"cloned_steps": lesson.evaluator.steps, "cloned": value}
    search = Search(
        agent, best, int(draw_seeds(seed, (_EVOLUTION,), 1)[0]), settings=settings, separable=False
    )
    while generations < settings["generations"] and value < task.enough:
        search.tell(lesson.returns(search.ask(), generations))
        generations += 1
        if generations % _JUDGED_EVERY == 0:
            judge(search.mean)
    evaluations = rounds + generations * settings["population"]
    ended = "enough" if value >= task.enough else "evaluations"
    return Found(best, evaluations, tuple(curve), ended), lesson.evaluator.steps, settings


def descend(student: Student, optimizer: Any, data: Any, window: int, slope: float) -> None:
    """Pass over episodes once, with a step of Adam for each window of them.

    ``data`` holds observations (E, T, inputs), the law's outputs (E, T, outputs) and weights (E, T, 1).
    """
    state = None
    for parts in zip(*(array.split(window, dim=1) for array in data), strict=True):
        seen, asked, weight = parts
        z, state = student.outputs(seen, state, slope)
        optimizer.zero_grad()
        ((weight * (z - asked) ** 2).sum() / weight.sum().clamp(min=1.0)).backward()
        optimizer.step()
        student.vector()
        state = state.detach()


class CarLesson:
    """Mountain car: episodes, and returns, of an agent."""

    _GAIN, _TICKS = 12.0, 400
    _JUDGED, _ROLLOUTS = 20, 4

    def __init__(self, task: Benchmark, agent: Policy | Net, seed: int) -> None:
        self._task, self._seed, self._judgements = task, seed, 0
        self._commander, self._shape = commander_for(agent)
        self.evaluator = Evaluator(task, agent)
        self.start = untuned(agent, search_generator(seed), 1)[0]

    def collect(self, number: int, vector: Vector | None) -> tuple[Vector, Vector, Vector]:
        """Return the data of a round, driven by parameters (P,) or by the law."""
        count = CLONING["episodes"]
        plants, pool = make_plants(self._task, count)
        arrays = self._commander.allocate(count)
        seeds = draw_seeds(self._seed, (_EPISODES, number), count)
        for lane, start in enumerate(first_states(self._task, seeds)):
            reset_plant(plants, lane, start)
            if vector is not None:
                self._commander.start_lane(arrays, lane, vector)
        running, totals = np.ones(count, np.bool_), np.zeros(count)
        now, commands = (np.zeros((rows, count)) for rows in self._shape)
        seen, weight = np.zeros((count, self._TICKS, len(now))), np.zeros((count, self._TICKS, 1))
        for tick in range(self._TICKS):
            observe_lanes(plants, now)
            seen[:, tick], weight[:, tick, 0] = now.T, running
            commands[:] = np.clip(self._GAIN * now[1:], -1.0, 1.0)
            if vector is not None:
                self._commander.tick_lanes(arrays, now, commands)
            step_lanes(plants, commands, running, totals)
        del pool  # kept alive until here: it owns MuJoCo's memory
        self.evaluator.steps += int(weight.sum())
        return seen, np.clip(self._GAIN * seen[:, :, 1:], -1.0, 1.0), weight

    def judge(self, vector: Vector) -> float:
        """Return a return of parameters (P,), confirmed if it is enough."""
        self._judgements += 1
        seeds = draw_seeds(self._seed, (_RETURNS, self._judgements), self._JUDGED)
        value = float(self.evaluator.returns(vector[None], seeds).mean())
        if value < self._task.enough:
            return value
        return confirmed(self.evaluator, vector, self._seed, self._judgements)

    def returns(self, vectors: Vector, generation: int) -> Vector:
        """Return what the evolution climbs, (k,) of candidates (k, P)."""
        seeds = draw_seeds(self._seed, (_EVOLUTION, generation), self._ROLLOUTS)
        means: Vector = self.evaluator.returns(vectors, seeds).mean(axis=1)
        return means


class ParkingLesson:
    """The parking course: episodes, and returns, of an agent."""

    _LAW, _GAINS = LAWS["kanayama"], np.array([0.5, 8.0, 4.0, 0.0, 0.0])
    """Softer than the tuned gains, whose commands saturate."""
    _STARTS = Randomization(name="starts", start_m=0.03, start_rad=0.06)

    def __init__(self, task: Task, agent: Policy | Net, seed: int) -> None:
        self._task, self._seed, self._course = task, seed, load_course("parking")
        self.evaluator, self._policy = ParkingEvaluator(task, agent), task.policy(task.circuit())
        self._limits = np.array(net_for(self._policy, NetKind.MLP).high)
        following = course_policy(tap_withdrawal_circuit())
        motors = following.motors.model_copy(update={"limits": tuple(self._limits)})
        self._following, self._reference = replace(following, motors=motors), plan_reference(self._course)
        self._commander, _ = commander_for(agent)
        drawn = search_generator(seed)
        self.start = agent.parameters() if isinstance(agent, Policy) else agent.start(drawn)

    def collect(self, number: int, vector: Vector | None) -> tuple[Vector, Vector, Vector]:
        """Return the data of a round, driven by parameters (P,) or by the law."""
        course, model, count = self._course, default_rover(), CLONING["episodes"]
        options = {"count": count, "ticks": course.ticks, "first": number * count}
        trials = draw_trials(self._STARTS, model, self._seed, **options)
        if vector is None:
            policy, commander = self._following, law_commander(self._LAW, self._following)
        else:
            policy, commander = self._policy, self._commander
        runner = CommanderRunner(commander, self._GAINS if vector is None else vector)
        own, theirs = RoverInterface(self._policy), RoverInterface(self._following)
        seen, asked = [], []
        for row in range(count):
            runner.reset()
            disturbed: dict[str, Any] = {"trials": trials, "row": row} if row else {}
            driven = rollout(policy, course, model, runner=runner, **disturbed)
            poses = [Pose(*pose) for pose in driven.seen.tolist()]
            signals = [course.start_signal(TICK_S * tick) for tick in range(course.ticks)]
            # The first tick is the circuit's warm-up.
            ticks = zip([poses[0], *poses], [0.0, *signals], strict=True)
            seen.append([own.observe(pose, signal, None) for pose, signal in ticks])
            shown = (theirs.observe(pose, 0.0, self._reference.tick(k)) for k, pose in enumerate(poses))
            commands = [law_command(self._LAW.number, self._GAINS, np.array(signals)) for signals in shown]
            asked.append([commands[0], *commands])
        self.evaluator.steps += count * course.ticks
        weight = np.ones((count, course.ticks + 1, 1))
        weight[:, 0] = 0.0
        return np.array(seen), np.clip(np.array(asked) / self._limits, [0.0, -1.0], 1.0), weight

    def judge(self, vector: Vector) -> float:
        """Return the return of parameters (P,), less 1 if they do not park."""
        self.evaluator.steps += self._course.ticks
        total, parked = self.evaluator.outcome(vector)
        return total if parked else total - 1.0

    def returns(self, vectors: Vector, generation: int) -> Vector:
        """Return what the evolution climbs, (k,) of candidates (k, P)."""
        return self.evaluator.traces(vectors)[1]
