"""Other controllers in the circuit's place: the same trials, search and budget, another body of numbers.

    python -m benchmarks.compare AGENT [--seed 1] [--generations 2600] [--rollouts 144] [--trained-on harsh]

prints one JSON object: what the search found, and how that does on trials that it did not see. Kept as
runs/compare/AGENT.json, it is a policy, with a network's state:

    rover-ncp eval benchmarks.compare:AGENT --trials 1000 --randomize harsh [--stack]

Agents:

circuit         the tap-withdrawal circuit with course-relative sensing, from its hand-set start
kanayama        the classical law (``kanayama.py``), from gains set by hand
mlp, lstm       networks of as many cells
lstm-small, cfc, ltc
                networks of about as many numbers
random-N        the circuit number N of random wiring, of as many neurons and synapses
absolute        the paper's sensing with ranges in which a rover that starts elsewhere still moves; it knows
                one course, so it is trained on that alone, from the policy that parks undisturbed
paper           the same with the paper's own ranges
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.liquid import PARTS, LiquidNet, liquid_lane_runner, liquid_net_for
from rover_ncp.circuit.policy import Policy, course_policy
from rover_ncp.circuit.policy_file import load_circuit, load_policy
from rover_ncp.circuit.sensing import Channel, Sensing
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.files import existing_file, read_text
from rover_ncp.core.streams import Domain, random_stream
from rover_ncp.course.course import Course, load_course
from rover_ncp.course.reference import plan_reference
from sim.evaluate.evaluate import unseen_courses
from sim.learn.engine.evaluator import Evaluator
from sim.learn.engine.kanayama import KANAYAMA, law_lane_runner
from sim.learn.engine.lane_runner import LaneRunner, OneLaneRunner, circuit_lane_runner
from sim.learn.engine.networks import CELLS, Net, NetKind, net_for, network_lane_runner
from sim.learn.random_circuit import random_circuit
from sim.learn.record import RobustSettings, made_with
from sim.learn.robust import RobustSearch, drive_trials, policy_box, training_courses
from sim.learn.search.unit_box import UnitBox
from sim.world.described import default_rover
from sim.world.randomization import draw_trials, load_randomization

FloatArray = NDArray[np.float64]

CIRCUIT = "circuit"
NETWORKS = {
    "mlp": (NetKind.MLP, CELLS),
    "lstm": (NetKind.LSTM, CELLS),
    "lstm-small": (NetKind.LSTM, 3),
}
"""Kind and number of cells: as many as the circuit has neurons, or about as many numbers as it has."""
RESULTS = Path("runs/compare"), Path("results/random-robots")
"""Folders of results, AGENT.json each."""

_RANDOM_COURSES = RobustSettings().random_courses
_TRIALS, _TRIALS_SEED, _UNSEEN = 1000, 31415, 200
_PROGRESS_GENERATIONS = 25


_FIRST_GAINS = (1.0, 20.0, 8.0, 0.01, 0.03)


class Agent(NamedTuple):
    """The search space, its engine, and whether the agent can follow any course."""

    box: UnitBox
    engine: Callable[..., Evaluator]
    any_course: bool


def find_agent(name: str, seed: int) -> Agent:
    """Return an agent by its name; networks draw their start from the seed. Raises KeyError."""
    following = course_policy(load_circuit("tracking"))
    if name == KANAYAMA:
        return Agent(gain_box(), partial(Evaluator, following, lane_runner=law_lane_runner()), True)
    if name in NETWORKS or name in PARTS:
        return _network(name, following, seed)
    if name.startswith("random-"):
        number, worm = int(name.removeprefix("random-")), load_circuit("tap_withdrawal")
        return _circuit(course_policy(random_circuit(number, worm.neurons, worm.synapse_count)), True)
    known: dict[str, Callable[[], Agent]] = {
        CIRCUIT: lambda: _circuit(following, True),
        "absolute": lambda: _circuit(replace(load_policy("parking"), sensing=_shifted_sensing()), False),
        "paper": lambda: _circuit(load_policy("parking"), False),
    }
    return known[name]()


def gain_box() -> UnitBox:
    """Return the search space of the law's gains: a tenth to ten times those that the tuning starts from."""
    first = np.array(_FIRST_GAINS)
    return UnitBox(0.1 * first, 10.0 * first, first, np.ones(len(first), np.bool_))


def _shifted_sensing() -> Sensing:
    table = (("x", "PVD", 1.0, -0.15), ("y", "PLM", 1.0, -0.15), ("theta", "ALM", 1.0, -0.25))
    moved = tuple(
        Channel(name=name, positive=neuron, maximum=end - origin, origin=origin)
        for name, neuron, end, origin in table
    )
    start = Channel(name="start", positive="AVM", maximum=1.0)
    return Sensing(name="shifted", inputs=("x", "y", "theta", "start"), channels=(*moved, start))


def _circuit(policy: Policy, any_course: bool) -> Agent:
    return Agent(policy_box(policy), partial(Evaluator, policy), any_course)


def _network(name: str, policy: Policy, seed: int) -> Agent:
    net, runner = find_network(name, policy)
    start = net.start(random_stream(seed, Domain.NETWORK_START))
    return Agent(UnitBox.of(net.layout(), start), partial(Evaluator, policy, lane_runner=runner), True)


def find_network(name: str, policy: Policy) -> tuple[Net | LiquidNet, LaneRunner]:
    """Return a network with the inputs and outputs of a policy, and what runs it."""
    if name in PARTS:
        liquid = liquid_net_for(policy, name)
        return liquid, liquid_lane_runner(liquid)
    net = net_for(policy, *NETWORKS[name])
    return net, network_lane_runner(net)


class Found:
    """What a comparison found for an agent, as a policy of ``rover-ncp eval``. Raises FileError."""

    def __init__(self, agent: str) -> None:
        paths = [folder / f"{agent}.json" for folder in RESULTS]
        path = existing_file(next((path for path in paths if path.is_file()), paths[0]))
        vector = np.array(json.loads(read_text(path))["found"])
        following = course_policy(load_circuit("tracking"))
        self.signals = following.sensing.inputs
        if agent == KANAYAMA:
            runner = law_lane_runner()
        elif agent == CIRCUIT:
            runner = circuit_lane_runner(following)
        else:
            _, runner = find_network(agent, following)
        if runner.size != len(vector):
            raise ConfigError(str(path), [f"$.found: expected {runner.size} numbers, got {len(vector)}"])
        self._runner = OneLaneRunner(runner, vector)

    def reset(self) -> None:
        """Begin a trial, with the warm-up tick that the training had."""
        self._runner.reset()
        self._warm = False

    def __call__(self, observation: FloatArray) -> tuple[float, ...]:
        """Return v and omega."""
        if not self._warm:
            self._runner.tick(observation)
            self._warm = True
        return self._runner.tick(observation)


def __getattr__(agent: str) -> Found:
    if agent in {CIRCUIT, KANAYAMA, *NETWORKS, *PARTS}:
        return Found(agent)
    raise AttributeError(f"module benchmarks.compare has no agent {agent}")


def compare(name: str, *, seed: int, generations: int, rollouts: int, trained_on: str) -> dict[str, Any]:
    """Search for an agent as the shipped circuit was searched for, and say how far that came."""
    began = time.process_time()
    agent, model, course = find_agent(name, seed), default_rover(), load_course("parking")
    courses, references = training_courses(
        course, plan_reference(course), seed, _RANDOM_COURSES if agent.any_course else 0
    )
    ranges = load_randomization(trained_on)
    nothing_yet = draw_trials(ranges, model, seed, count=1, ticks=max(each.ticks for each in courses))
    drive = drive_trials(
        agent.engine(courses, trials=nothing_yet, references=references), ranges, model, seed
    )
    search = RobustSearch(agent.box, seed=seed, rollouts=rollouts, worst=rollouts)
    while search.number < generations:
        last = search.advance(drive)
        if last.iterations % _PROGRESS_GENERATIONS == 0:
            print(f"{name}: generation {last.iterations}, cost {last.best:.3f}", file=sys.stderr, flush=True)

    def judged(courses: Sequence[Course], ranges: str) -> dict[str, float]:
        ticks = max(each.ticks for each in courses)
        trials = draw_trials(load_randomization(ranges), model, _TRIALS_SEED, count=_TRIALS, ticks=ticks)
        found = agent.engine(courses, trials=trials).outcomes(last.winner)
        return {
            "success_rate": float(found.parked.mean()),
            "error_m_p95": float(np.percentile(found.error_m, 95)),
        }

    results = {ranges: judged([course], ranges) for ranges in ("mild", "full", "harsh", "skid")}
    if agent.any_course:
        results["unseen"] = judged(unseen_courses(_TRIALS_SEED, _UNSEEN), "full")
    return {
        "agent": name,
        "seed": seed,
        "trained_on": trained_on,
        "generations": generations,
        "rollouts": rollouts,
        "numbers": agent.box.size,
        "episodes": search.episodes,
        "cpu_s": round(time.process_time() - began),
        "made_with": made_with(),
        **results,
        "found": last.winner.tolist(),
    }


def main() -> None:
    """Compare from the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.compare")
    parser.add_argument("agent")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--generations", type=int, default=2600)
    parser.add_argument("--rollouts", type=int, default=144)
    parser.add_argument("--trained-on", default="harsh", help="ranges of the training's trials")
    given = parser.parse_args()
    found = compare(
        given.agent,
        seed=given.seed,
        generations=given.generations,
        rollouts=given.rollouts,
        trained_on=given.trained_on,
    )
    print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
