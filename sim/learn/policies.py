"""Policies under test: circuits and policies of a user, both by the names of their signals."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.own_policy import FunctionRunner, is_own, load_own_policy, own_policy
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.circuit.runner import Runner

FloatArray = NDArray[np.float64]
AnyRunner: TypeAlias = Runner | FunctionRunner


@dataclass(frozen=True, eq=False)
class AnyPolicy:
    """A policy under test: it observes signals by name and commands v and omega."""

    name: str
    signals: tuple[str, ...]
    runner: Callable[[], AnyRunner]
    """Return a runner of the policy; other processes may call this, too."""
    circuit: Policy | None = None
    """The policy of a circuit, which an evaluator can drive; None for a policy of a user."""

    @property
    def neurons(self) -> tuple[str, ...]:
        """Names of a circuit's neurons."""
        return self.circuit.circuit.neurons if self.circuit else ()


def any_policy(given: Policy | Callable[[FloatArray], Any] | str | Path) -> AnyPolicy:
    """Return a policy under test: a circuit's, or a user's function, or the name of one of them.

    A name is ``module:name``, a shipped policy or a file. Raises ConfigError, also for a policy that drives
    no rover, FileError or UsageError.
    """
    if isinstance(given, str | Path):
        if is_own(str(given)):
            return AnyPolicy(*load_own_policy(str(given)))
        given = load_policy(given)
    if isinstance(given, Policy):
        RoverInterface(given)
        return AnyPolicy(given.circuit.name, given.sensing.inputs, partial(Runner, given), given)
    policy = given
    return AnyPolicy(*own_policy(getattr(policy, "__name__", type(policy).__name__), lambda: policy))
