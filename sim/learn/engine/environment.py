"""Episodes of any Gymnasium environment with a circuit as its policy.

An entry of the observation is an input of the policy, in the order of ``sensing.inputs``. An entry of the
action is an output, in the order of ``motors.outputs``, and is cut to the action space's bounds; where
actions are numbers 0 to n - 1, the largest of n outputs chooses one. A step of the environment is one control
tick of the circuit, which begins an episode at rest.
"""

import warnings
from copy import copy
from typing import Any, NamedTuple, Self, TypeAlias

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.runner import Runner
from rover_ncp.core.errors import ConfigError, UsageError
from rover_ncp.core.files import importable_working_folder
from sim.learn.engine.lane_runner import circuit_lane_runner
from sim.learn.search.base import Seeds

Environment: TypeAlias = gymnasium.Env[Any, Any]
FloatArray = NDArray[np.float64]

MAX_STEPS = 100_000
_LANES = 32


class Play(NamedTuple):
    """One episode of T steps."""

    outputs: FloatArray
    """(T, outputs)."""
    potentials: FloatArray
    """(T, n) mV, after each tick."""
    rewards: FloatArray
    """(T,)."""


def make_environment(name: str) -> Environment:
    """Make an environment by its id; ``module:id`` imports a module first, also one in the working folder.

    Raises UsageError.
    """
    try:
        with importable_working_folder(), warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            return gymnasium.make(name)
    except (gymnasium.error.Error, ImportError) as error:
        raise UsageError(f"environment {name}: {str(error).strip()}") from error


def require_fit(name: str, environment: Environment, policy: Policy) -> None:
    """Raise ConfigError unless a policy's inputs and outputs are the environment's."""
    seen, action = environment.observation_space, environment.action_space
    inputs, outputs = policy.sensing.inputs, policy.motors.outputs
    problems = []
    if not isinstance(seen, gymnasium.spaces.Box) or len(seen.shape) != 1:
        problems.append(f"its observation must be a Box of one row, got {seen}; FlattenObservation makes one")
    elif seen.shape[0] != len(inputs):
        problems.append(f"its observation has {seen.shape[0]} entries, the policy inputs {', '.join(inputs)}")
    if isinstance(action, gymnasium.spaces.Discrete):
        count = int(action.n)
    elif isinstance(action, gymnasium.spaces.Box) and len(action.shape) == 1:
        count = action.shape[0]
    else:
        problems.append(f"its action must be a Box of one row, or Discrete, got {action}")
        count = len(outputs)
    if count != len(outputs):
        problems.append(f"its action needs {count} outputs, the policy has {', '.join(outputs)}")
    if problems:
        raise ConfigError(f"environment {name}", problems)


class EnvironmentEvaluator:
    """Scores parameter vectors of a policy by episodes of an environment. One thread at a time.

    ``made`` is an environment of this name, if there is one already. Raises UsageError for an environment
    that cannot be made, ConfigError for one that is not the policy's.
    """

    def __init__(self, name: str, policy: Policy, made: Environment | None = None) -> None:
        self.name, self.steps = name, 0
        self._environments = [made or make_environment(name)]
        require_fit(name, self._environments[0], policy)
        self.enough = None if (spec := self._environments[0].spec) is None else spec.reward_threshold
        """The return that counts as solved; None where the environment names none."""
        self._connect(policy)

    def of(self, policy: Policy) -> Self:
        """Return an evaluator of another policy with the same inputs and outputs, in these environments."""
        other = copy(self)
        other._connect(policy)
        return other

    def _connect(self, policy: Policy) -> None:
        self.policy = policy
        self._lane_runner = circuit_lane_runner(policy)
        self._arrays = self._lane_runner.allocate(_LANES)
        self._observations = np.zeros((len(policy.sensing.inputs), _LANES))
        self._outputs = np.zeros((len(policy.motors.outputs), _LANES))

    def returns(self, vectors: ArrayLike, seeds: Seeds) -> FloatArray:
        """Return the returns (n, k) of vectors (n, P), each in the episodes of seeds (k,)."""
        rows = np.ascontiguousarray(np.atleast_2d(np.asarray(vectors, np.float64)))
        while len(self._environments) < min(_LANES, len(rows) * len(seeds)):
            self._environments.append(make_environment(self.name))
        found = np.zeros(len(rows) * len(seeds))
        running: dict[int, list[int]] = {}
        waiting = list(range(len(found)))[::-1]
        free = list(range(len(self._environments)))[::-1]
        while running or waiting:
            while free and waiting:
                lane, episode = free.pop(), waiting.pop()
                self._lane_runner.start_lane(self._arrays, lane, rows[episode // len(seeds)])
                seen, _ = self._environments[lane].reset(seed=_seed(seeds[episode % len(seeds)]))
                self._observations[:, lane] = self._checked(seen)
                running[lane] = [episode, 0]
            self._lane_runner.tick_lanes(self._arrays, self._observations, self._outputs)
            for lane, state in list(running.items()):
                seen, reward, over = self._step(self._environments[lane], self._outputs[:, lane], state[1])
                found[state[0]] += reward
                state[1] += 1
                if over:
                    del running[lane]
                    free.append(lane)
                else:
                    self._observations[:, lane] = seen
        return found.reshape(len(rows), len(seeds))

    def play(self, seed: int) -> Play:
        """Play one episode of the policy."""
        runner, environment = Runner(self.policy), self._environments[0]
        observation, _ = environment.reset(seed=_seed(seed))
        seen = self._checked(observation)
        rows: list[tuple[Any, ...]] = []
        over = False
        while not over:
            outputs = runner.tick(seen)
            seen, reward, over = self._step(environment, np.array(outputs), len(rows))
            rows.append((outputs, runner.potentials, reward))
        return Play(*(np.array(part) for part in zip(*rows, strict=True)))

    def _step(
        self, environment: Environment, outputs: FloatArray, step: int
    ) -> tuple[FloatArray, float, bool]:
        """Advance an environment; return the observation, the reward and whether the episode is over."""
        space: Any = environment.action_space
        if isinstance(space, gymnasium.spaces.Discrete):
            action: Any = space.start + outputs.argmax()
        else:
            action = np.clip(outputs, space.low, space.high).astype(space.dtype)
        seen, reward, terminated, truncated, _ = environment.step(action)
        self.steps += 1
        if step + 1 == MAX_STEPS and not (terminated or truncated):
            problem = f"an episode has not ended after {MAX_STEPS} steps; register it with max_episode_steps"
            raise ConfigError(f"environment {self.name}", [problem])
        return self._checked(seen), float(reward), bool(terminated or truncated)

    def _checked(self, seen: Any) -> FloatArray:
        values = np.asarray(seen, np.float64)
        if not np.isfinite(values).all():
            raise ConfigError(
                f"environment {self.name}", [f"an observation is not finite: {values.tolist()}"]
            )
        return values


def _seed(seed: Any) -> int:
    """Return a seed that every environment takes: numpy's old generators have 32 bits."""
    return int(seed) % 2**32
