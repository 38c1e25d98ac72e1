"""Policies under test: circuits and policies of a user, both by the names of their signals."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.own_policy import is_own, load_own_policy, own_policy
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.circuit.rover_interface import FunctionRunner, RoverInterface
from rover_ncp.circuit.runner import Runner

FloatArray = NDArray[np.float64]
AnyRunner: TypeAlias = Runner | FunctionRunner


@dataclass(frozen=True, eq=False)
class Driver:
    """A policy under test: it observes signals by name and commands v and omega."""

    name: str
    signals: tuple[str, ...]
    runner: Callable[[], AnyRunner]
    """Return a runner of the policy; other processes may call this, too."""
    circuit: Policy | None = None
    """The policy of a circuit, which an episode kernel can drive; None for a policy of a user."""

    @property
    def neurons(self) -> tuple[str, ...]:
        """Names of a circuit's neurons."""
        return self.circuit.circuit.neurons if self.circuit else ()


def load_driver(name: str) -> Driver:
    """Load a policy of a user as ``module:name``, or a circuit's policy by name or file.

    Raises ConfigError, FileError or UsageError.
    """
    if is_own(name):
        return Driver(*load_own_policy(name))
    return circuit_driver(load_policy(name))


def circuit_driver(policy: Policy) -> Driver:
    """Return a circuit's policy under test. Raises ConfigError for one that drives no rover."""
    RoverInterface(policy)
    return Driver(policy.circuit.name, policy.sensing.inputs, partial(Runner, policy), policy)


def function_driver(policy: Callable[[FloatArray], Any]) -> Driver:
    """Return a policy of a user under test. Raises ConfigError or UsageError."""
    name = getattr(policy, "__name__", type(policy).__name__)
    return Driver(*own_policy(name, lambda: policy))
