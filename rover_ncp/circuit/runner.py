"""Runs one policy tick by tick, with the native library where it was built."""

import logging
import math
from collections.abc import Callable, Sequence
from functools import cache, partial

import numpy as np

from rover_ncp.circuit import reference
from rover_ncp.circuit.circuit import RESTING_MV, FloatArray
from rover_ncp.circuit.compiled import make_circuits, make_program
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import UsageError
from rover_ncp.native.core import bound_tick, library

_LOGGER = logging.getLogger("rover_ncp")


class Runner:
    """One policy and its neurons' potentials, at rest to begin with."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self._observation = np.empty((len(policy.sensing.inputs), 1))
        self._command = np.empty((len(policy.motors.outputs), 1))
        self._run: Callable[[], object]
        if library() is None:
            _warn_once()
            program, self._potentials = make_program(policy), np.full((policy.circuit.size, 1), RESTING_MV)
            state = self._potentials, self._observation, self._command
            self._run = partial(reference.tick, program, policy.parameters(), *state)
        else:
            circuits = make_circuits(policy, 1)
            self._potentials = circuits.potentials
            self._run = bound_tick(circuits, self._observation, self._command)

    def __getstate__(self) -> tuple[Policy, FloatArray]:
        return self.policy, self.potentials

    def __setstate__(self, state: tuple[Policy, FloatArray]) -> None:
        # A copy has arrays of its own, to which its calls of the library must point.
        self.__init__(state[0])  # type: ignore[misc]
        self._potentials[:, 0] = state[1]

    @property
    def potentials(self) -> FloatArray:
        """A copy of all potentials (n,) in mV."""
        return self._potentials[:, 0].copy()

    def reset(self) -> None:
        """Put every neuron at rest."""
        self._potentials[:] = RESTING_MV

    def tick(self, observation: Sequence[float] | FloatArray) -> tuple[float, ...]:
        """Run one control tick on an observation (inputs,) and return the outputs.

        For driving: the sensing's signals (``course/signals.py``) to (v, omega) in m/s and rad/s. Raises
        UsageError for an observation of another length or with a number that is not finite; the state is
        then unchanged.
        """
        inputs = self.policy.sensing.inputs
        if len(observation) != len(inputs):
            raise UsageError(f"an observation needs {len(inputs)} values ({', '.join(inputs)})")
        for name, value in zip(inputs, observation, strict=True):
            if not math.isfinite(value):
                raise UsageError(f"the observation {name} is {value}, expected a finite number")
        self._observation[:, 0] = observation
        self._run()
        return tuple(self._command[:, 0].tolist())


@cache
def _warn_once() -> None:
    _LOGGER.warning("warning: the native library was not built: circuits run in Python, fast enough to drive")
