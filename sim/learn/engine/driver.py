"""Policies under test: circuits and policies of a user, both by the names of their signals."""

import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.circuit.rover_interface import DEFAULT_SIGNALS, FunctionRunner, RoverInterface
from rover_ncp.circuit.runner import Runner
from rover_ncp.core.errors import ConfigError, RoverNcpError, UsageError
from rover_ncp.core.files import importable_working_folder

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
    if ":" in name and not Path(name).exists():
        return _own_driver(name, partial(_imported, name))
    return circuit_driver(load_policy(name))


def circuit_driver(policy: Policy) -> Driver:
    """Return a circuit's policy under test. Raises ConfigError for one that drives no rover."""
    RoverInterface(policy)
    return Driver(policy.circuit.name, policy.sensing.inputs, partial(Runner, policy), policy)


def function_driver(policy: Callable[[FloatArray], Any]) -> Driver:
    """Return a policy of a user under test. Raises ConfigError or UsageError."""
    name = getattr(policy, "__name__", type(policy).__name__)
    return _own_driver(name, lambda: policy)


def _own_driver(name: str, load: Callable[[], Any]) -> Driver:
    policy = load()
    if not callable(policy):
        raise UsageError(f"policy {name}: expected a function of an observation, got {policy!r}")
    signals = getattr(policy, "signals", DEFAULT_SIGNALS)
    if isinstance(signals, str) or not isinstance(signals, Sequence):
        raise UsageError(f"policy {name}: expected signals as a tuple of names, got {signals!r}")
    try:
        RoverInterface(signals)
    except ConfigError as error:
        raise ConfigError(f"policy {name}", error.problems) from error
    return Driver(name, tuple(signals), partial(_function_runner, name, load))


def _imported(source: str) -> Any:
    """Return what ``module:name`` names; a class is called without arguments. Raises UsageError."""
    module, _, name = source.partition(":")
    try:
        with importable_working_folder():
            found = getattr(import_module(module), name)
        return found() if isinstance(found, type) else found
    except RoverNcpError:
        raise
    except Exception as error:
        raise UsageError(f"policy {source}: {_described(error)}") from error


def _function_runner(name: str, load: Callable[[], Any]) -> AnyRunner:
    policy = load()
    return FunctionRunner(partial(_command, name, policy), getattr(policy, "reset", lambda: None))


def _command(name: str, policy: Any, observation: FloatArray) -> FloatArray:
    """Return the policy's v and omega. Raises UsageError unless they are two finite numbers."""
    try:
        answer = policy(observation)
        command = np.asarray(answer, np.float64)
    except RoverNcpError:
        raise
    except Exception as error:
        raise UsageError(f"policy {name}: {_described(error)}") from error
    if command.shape != (2,) or not np.isfinite(command).all():
        raise UsageError(f"policy {name}: expected v and omega as two finite numbers, got {answer!r}")
    return command


def _described(error: Exception) -> str:
    """Return an exception of a user's module in one line, with its place."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    words = " ".join(str(error).split())
    return f"{type(error).__name__}: {words} ({Path(last.filename).name}, line {last.lineno})"
