"""Policies of a user in Python: a function from an observation to v and omega, named as ``module:name``."""

import traceback
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rover_ncp.circuit.rover_interface import DEFAULT_SIGNALS, RoverInterface
from rover_ncp.core.errors import ConfigError, RoverNcpError, UsageError
from rover_ncp.core.files import importable_working_folder

FloatArray = NDArray[np.float64]


class FunctionRunner:
    """Runs a function from an observation (n,) to v in m/s and omega in rad/s, in place of a circuit.

    A circuit makes a warm-up tick at the start of a drive. The function is not called for it.
    """

    def __init__(
        self, function: Callable[[FloatArray], ArrayLike], reset: Callable[[], object] = lambda: None
    ) -> None:
        self._function, self._reset = function, reset
        self._started = self._warm = False

    def __deepcopy__(self, memo: object) -> Self:
        """Return the runner itself: `reset` alone begins a drive."""
        return self

    @property
    def potentials(self) -> FloatArray:
        """None: (0,)."""
        return np.empty(0)

    def reset(self) -> None:
        """Begin a drive, whose first tick is the warm-up."""
        self._started, self._warm = True, False
        self._reset()

    def tick(self, observation: Sequence[float] | FloatArray) -> tuple[float, ...]:
        """Return the function's command; zero in the warm-up and before the first drive."""
        if not self._warm:
            self._warm = self._started
            return 0.0, 0.0
        v, omega = np.asarray(self._function(np.array(observation, np.float64)), np.float64).tolist()
        return v, omega


class OwnPolicy(NamedTuple):
    """A policy of a user."""

    name: str
    signals: tuple[str, ...]
    """What it observes."""
    runner: Callable[[], FunctionRunner]
    """Makes a new runner, also in other processes, since it imports the policy again."""


def is_own(name: str) -> bool:
    """Return whether the name of a policy is a ``module:name`` and not an existing file."""
    return ":" in name and not Path(name).exists()


def load_own_policy(name: str) -> OwnPolicy:
    """Import a policy as ``module:name``. Raises ConfigError or UsageError."""
    return own_policy(name, partial(_imported, name))


def own_policy(name: str, load: Callable[[], Any]) -> OwnPolicy:
    """Check the function that ``load`` returns; return it as a policy. Raises ConfigError or UsageError."""
    policy = load()
    if _function(policy) is None:
        raise UsageError(
            f"policy {name}: expected a function of an observation, or a model with predict, got {policy!r}"
        )
    signals = getattr(policy, "signals", DEFAULT_SIGNALS)
    if isinstance(signals, str) or not isinstance(signals, Sequence):
        raise UsageError(f"policy {name}: expected signals as a tuple of names, got {signals!r}")
    try:
        RoverInterface(signals)
    except ConfigError as error:
        raise ConfigError(f"policy {name}", error.problems) from error
    return OwnPolicy(name, tuple(signals), partial(_function_runner, name, load))


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


def _function_runner(name: str, load: Callable[[], Any]) -> FunctionRunner:
    policy = load()
    function = _function(policy)
    assert function is not None  # own_policy checked the same
    observes = ", ".join(getattr(policy, "signals", DEFAULT_SIGNALS))
    if not hasattr(policy, "signals"):
        observes += " without an attribute signals"
    return FunctionRunner(partial(_command, name, function, observes), getattr(policy, "reset", lambda: None))


def _function(policy: Any) -> Callable[[FloatArray], Any] | None:
    """Return a policy as a function: itself, or a model of Stable-Baselines3 without its noise."""
    if callable(policy):
        return policy  # type: ignore[no-any-return]
    if predict := getattr(policy, "predict", None):
        return lambda observation: predict(observation, deterministic=True)[0]
    return None


def _command(
    name: str, function: Callable[[FloatArray], Any], observes: str, observation: FloatArray
) -> FloatArray:
    """Return the policy's v and omega. Raises UsageError unless they are two finite numbers."""
    try:
        answer = function(observation)
        command = np.asarray(answer, np.float64)
    except RoverNcpError:
        raise
    except Exception as error:
        raise UsageError(f"policy {name}: {_described(error)}; it observes {observes}") from error
    if command.shape != (2,) or not np.isfinite(command).all():
        raise UsageError(f"policy {name}: expected v and omega as two finite numbers, got {answer!r}")
    return command


def _described(error: Exception) -> str:
    """Return an exception of a user's module in one line, with its place."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    words = " ".join(str(error).split())
    return f"{type(error).__name__}: {words} ({Path(last.filename).name}, line {last.lineno})"
