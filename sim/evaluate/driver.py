"""What drives in an evaluation: a policy's circuit, a classical law, or what a comparison found."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from rover_ncp.circuit.policy import Policy, course_policy
from rover_ncp.circuit.policy_file import load_circuit, load_policy
from rover_ncp.core.config import validated
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.files import existing_file, read_text
from rover_ncp.course.course import Course
from sim.learn.engine.commander import Commander, CommanderRunner, circuit_commander
from sim.learn.engine.evaluator import Evaluator
from sim.learn.engine.laws import LAWS, law_commander
from sim.learn.engine.networks import CELLS, LIQUID_CELLS, NetKind, net_for, network_commander
from sim.world.randomization import Trials
from sim.world.rover import RoverModel

FloatArray = NDArray[np.float64]

CIRCUIT = "circuit"
NETWORKS = {
    "mlp": (NetKind.MLP, CELLS),
    "lstm": (NetKind.LSTM, CELLS),
    "lstm-small": (NetKind.LSTM, 3),
    "cfc": (NetKind.CFC, LIQUID_CELLS),
    "ltc": (NetKind.LTC, LIQUID_CELLS),
}
"""Kind and number of cells: as many as the circuit has neurons, or about as many numbers as it has."""


@dataclass(frozen=True, eq=False)
class Driver:
    """A controller with its numbers. Of the policy, laws and networks have the signals and limits only."""

    policy: Policy
    agent: str = CIRCUIT
    """``CIRCUIT``, or a key of ``LAWS`` or ``NETWORKS``."""
    found: tuple[float, ...] | None = None
    """The numbers of a law or a network."""

    @property
    def name(self) -> str:
        """The policy's or the agent's name."""
        return self.policy.circuit.name if self.agent == CIRCUIT else self.agent

    @property
    def neurons(self) -> tuple[str, ...]:
        """Names of the neurons; none without a circuit."""
        return self.policy.circuit.neurons if self.agent == CIRCUIT else ()

    @property
    def vector(self) -> FloatArray:
        """The numbers (P,)."""
        return self.policy.parameters() if self.found is None else np.array(self.found)

    @property
    def commander(self) -> Commander:
        """What drives the lanes of an episode kernel."""
        if self.agent in LAWS:
            return law_commander(LAWS[self.agent], self.policy)
        if self.agent in NETWORKS:
            return network_commander(net_for(self.policy, *NETWORKS[self.agent]))
        return circuit_commander(self.policy)

    def evaluator(self, courses: Sequence[Course], model: RoverModel, trials: Trials) -> Evaluator:
        """Return an evaluator for vectors like this driver's."""
        return Evaluator(self.policy, courses, model, trials, commander=self.commander)

    def runner(self) -> CommanderRunner | None:
        """Return what a deploy controller runs in the place of the policy's circuit, if anything."""
        return None if self.agent == CIRCUIT else CommanderRunner(self.commander, self.vector)


class _Found(BaseModel):
    """What this module reads of the result of ``benchmarks/compare.py``."""

    agent: str
    found: tuple[float, ...]


def load_driver(name: str) -> Driver:
    """Load a law by name, a result of ``benchmarks/compare.py`` (.json), or a policy by name or file.

    Raises ConfigError or FileError.
    """
    if name in LAWS:
        return Driver(_following(), name, LAWS[name].tuned)
    if not name.endswith(".json"):
        return Driver(load_policy(name))
    try:
        content = json.loads(read_text(existing_file(Path(name))))
    except ValueError as error:
        raise ConfigError(name, [f"not valid JSON: {error}"]) from error
    result = validated(content, _Found, name)
    if result.agent not in {CIRCUIT, *LAWS, *NETWORKS}:
        known = ", ".join([CIRCUIT, *LAWS, *NETWORKS])
        raise ConfigError(name, [f"$.agent: expected one of {known}, got {result.agent}"])
    driver = Driver(_following(), result.agent, result.found)
    if (count := driver.commander.size) != len(result.found):
        raise ConfigError(name, [f"$.found: expected {count} numbers, got {len(result.found)}"])
    if result.agent == CIRCUIT:
        return Driver(driver.policy.with_parameters(driver.vector))
    return driver


def _following() -> Policy:
    """Return the policy whose signals and limits laws and networks have."""
    return course_policy(load_circuit("tracking"))
