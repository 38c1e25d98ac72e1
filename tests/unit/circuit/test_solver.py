from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.wirings import in_bounds, unit_vectors, wirings

from rover_ncp.circuit import runner as runner_module
from rover_ncp.circuit.compiled import make_circuits
from rover_ncp.circuit.motors import Motors, parking_motors
from rover_ncp.circuit.policy import Policy, parking_policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.circuit.runner import Runner
from rover_ncp.circuit.sensing import Sensing, parking_sensing
from rover_ncp.native import core
from rover_ncp.native.core import bound_tick, fill_lanes

PARKING = parking_policy(load_circuit("parking"))
SIZE = PARKING.layout().size
ANY_INPUT = st.floats(allow_nan=False, allow_infinity=False)
NEAR_INPUT = st.floats(-2, 2)


def draw_observations(data, policy, most):
    elements = st.lists(NEAR_INPUT, min_size=len(policy.sensing.inputs), max_size=len(policy.sensing.inputs))
    return data.draw(st.lists(elements, min_size=1, max_size=most))


@given(wirings(), st.data())
def test_the_library_has_the_bits_of_the_equation_in_python(policy, data):
    native = Runner(policy)
    with mock.patch.object(runner_module, "library", return_value=None):
        python = Runner(policy)
    for observation in draw_observations(data, policy, 8):
        assert native.tick(observation) == python.tick(observation)
        assert native.potentials.tobytes() == python.potentials.tobytes()


@given(
    unit=unit_vectors(SIZE),
    observations=st.lists(st.tuples(*[ANY_INPUT | NEAR_INPUT] * 4), min_size=1, max_size=8),
)
def test_clamped_potentials_never_leave_the_reversal_potentials(unit, observations):
    runner = Runner(PARKING.with_parameters(in_bounds(PARKING, unit)))
    for observation in observations:
        runner.tick(observation)
        assert runner.potentials.min() >= -90 - 1e-9
        assert runner.potentials.max() <= 0


@given(unit=unit_vectors(SIZE), observation=st.tuples(*[ANY_INPUT] * 4))
def test_unclamped_sensors_far_out_stay_finite(unit, observation):
    policy = parking_policy(load_circuit("parking"), clamp=False)
    runner = Runner(policy.with_parameters(in_bounds(policy, unit)))
    for _ in range(3):
        v, omega = runner.tick(observation)
        assert np.isfinite(runner.potentials).all()
        assert 0 <= v <= 0.16
        assert -0.18 <= omega <= 0.18


def run_lanes(policy, vectors, observations):
    """Run lanes (L, P) over observations (ticks, inputs, L); return potentials (n, L) and commands (o, L)."""
    circuits = make_circuits(policy, len(vectors))
    observation = np.empty(observations.shape[1:])
    commands = np.empty((len(policy.motors.outputs), len(vectors)))
    tick = bound_tick(circuits, observation, commands)
    fill_lanes(circuits, vectors[::-1].copy())  # lanes can be set anew
    fill_lanes(circuits, vectors[3:], first=3)
    fill_lanes(circuits, vectors[:3])
    for observation[:] in observations:
        tick()
    return circuits.potentials, commands


LAYERED = Policy(
    load_circuit("parking"),
    Sensing(name="layered", inputs=tuple("abcde"), channels=parking_sensing().channels),
    Motors(outputs=("p", "q", "r"), channels=parking_motors().channels),
    input_layer=np.zeros((4, 5)),
    output_layer=np.zeros((3, 2)),
)


@pytest.mark.parametrize(("policy", "width"), [*((PARKING, width) for width in (7, 8, 9, 33)), (LAYERED, 11)])
def test_a_lane_does_not_notice_its_neighbours(policy, width):
    rng = np.random.default_rng(width)
    vectors = in_bounds(policy, rng.random((width, policy.layout().size)))
    observations = rng.uniform(-0.5, 1.5, (10, len(policy.sensing.inputs), width))
    potentials, commands = run_lanes(policy, vectors, observations)
    for lane in range(width):
        runner = Runner(policy.with_parameters(vectors[lane]))
        for observation in observations:
            command = runner.tick(observation[:, lane])
        assert runner.potentials.tobytes() == potentials[:, lane].tobytes()
        assert np.array(command).tobytes() == commands[:, lane].tobytes()


def test_both_builds_of_the_library_give_the_same_bits():
    # Where there is no AVX2 this compares one build with itself.
    rng = np.random.default_rng(3)
    observations = rng.uniform(-0.5, 1.5, (20, 4, 11))
    vectors = in_bounds(PARKING, rng.random((11, SIZE)))
    expected = run_lanes(PARKING, vectors, observations)
    with mock.patch.object(core, "library", core.load):
        found = run_lanes(PARKING, vectors, observations)
    for a, b in zip(expected, found, strict=True):
        assert a.tobytes() == b.tobytes()
