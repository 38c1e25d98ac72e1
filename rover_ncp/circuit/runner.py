"""Runs one policy tick by tick; needs numba."""

import math
from collections.abc import Sequence

import numpy as np

from rover_ncp.circuit.circuit import RESTING_MV, FloatArray
from rover_ncp.circuit.compiled import allocate_lanes, make_program
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.solver import tick_lanes
from rover_ncp.core.errors import UsageError


class Runner:
    """One policy and its neurons' potentials, at rest to begin with."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self._program = make_program(policy)
        self._lanes = allocate_lanes(self._program, policy, 1)
        self._potentials = np.full((policy.circuit.size, 1), RESTING_MV)
        self._observation = np.empty((len(policy.sensing.inputs), 1))
        self._command = np.empty((len(policy.motors.outputs), 1))

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
        tick_lanes(self._program, self._lanes, self._potentials, self._observation, self._command)
        return tuple(self._command[:, 0].tolist())
