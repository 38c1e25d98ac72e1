import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit import solver_reference as reference
from kit.wirings import in_bounds, unit_vectors, wirings

from paper.tasks import build_circuit
from rover_ncp.circuit.circuit import SynapseKind, time_constants
from rover_ncp.circuit.compiled import allocate_lanes, fill_lane, make_program, resting_potentials
from rover_ncp.circuit.motors import Motors, parking_motors
from rover_ncp.circuit.policy import Policy, parking_policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.circuit.runner import Runner
from rover_ncp.circuit.sensing import Sensing, parking_sensing
from rover_ncp.circuit.solver import exp2, tick_lanes
from rover_ncp.kernels.jit import kernel

PARKING = parking_policy(load_circuit("parking"))
SIZE = PARKING.layout().size
ANY_INPUT = st.floats(allow_nan=False, allow_infinity=False)
NEAR_INPUT = st.floats(-2, 2)


@kernel
def exp2_of_all(values, results):
    """Call exp2 from a kernel, as it is meant to be."""
    for i in range(len(values)):
        results[i] = exp2(values[i])


def test_exp2_is_exact_to_two_units_in_the_last_place():
    rng = np.random.default_rng(1)
    values = np.concatenate(
        [rng.uniform(-1000, 1000, 200_000), rng.uniform(-2, 2, 200_000), np.arange(-1000, 1001)]
    )
    results = np.empty_like(values)
    exp2_of_all(values, results)
    expected = np.exp2(values)
    assert np.max(np.abs(results - expected) / np.spacing(expected)) <= 2


def draw_observations(data, policy, most):
    elements = st.lists(NEAR_INPUT, min_size=len(policy.sensing.inputs), max_size=len(policy.sensing.inputs))
    return data.draw(st.lists(elements, min_size=1, max_size=most))


@given(wirings(), st.data())
def test_a_step_of_the_kernel_is_the_references(policy, data):
    # From the same potentials each: in ten steps, steep synapses multiply what rounding leaves by a million.
    policy = replace(policy, substeps=1)
    runner = Runner(policy)
    for observation in draw_observations(data, policy, 8):
        before = runner.potentials
        command = runner.tick(observation)
        potentials, outputs = reference.tick(policy, before, np.array(observation))
        np.testing.assert_allclose(runner.potentials, potentials, atol=1e-11, rtol=0)
        np.testing.assert_allclose(command, outputs, atol=1e-11, rtol=0)


@given(wirings(), st.integers(2, 12), st.data())
def test_a_tick_is_so_many_steps(policy, substeps, data):
    whole, stepped = (Runner(replace(policy, substeps=count)) for count in (substeps, 1))
    for observation in draw_observations(data, policy, 4):
        commands = [stepped.tick(observation) for _ in range(substeps)]
        assert whole.tick(observation) == commands[-1]
        assert np.array_equal(whole.potentials, stepped.potentials)


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
    potentials = resting_potentials(policy, len(vectors))
    commands = np.empty((len(policy.motors.outputs), len(vectors)))
    program = make_program(policy)
    lanes = allocate_lanes(program, policy, len(vectors))
    for lane in reversed(range(len(vectors))):
        fill_lane(program, lanes, lane, vectors[0])  # a lane can be set anew
        fill_lane(program, lanes, lane, vectors[lane])
    for observation in observations:
        tick_lanes(program, lanes, potentials, observation, commands)
    return potentials, commands


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


# Prints the bits of a short run, for a processor whose name is in NUMBA_CPU_NAME.
SHORT_RUN = """
import json
from rover_ncp.circuit.policy import parking_policy
from rover_ncp.circuit.runner import Runner
from rover_ncp.circuit.policy_file import load_circuit
runner = Runner(parking_policy(load_circuit("parking")))
commands = [runner.tick([0.01 * k, 0.005 * k, 0.02 * k, float(k > 5)]) for k in range(50)]
print(json.dumps([commands, runner.potentials.tolist()]))
"""


@pytest.mark.long
def test_another_processor_gives_the_same_bits(tmp_path):
    def run(**environment):
        command = [sys.executable, "-c", SHORT_RUN]
        done = subprocess.run(
            command, env=os.environ | environment, capture_output=True, check=True, timeout=100
        )
        return json.loads(done.stdout)

    oldest = run(NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES="", NUMBA_CACHE_DIR=str(tmp_path))
    assert oldest == run()


def test_time_constant_is_that_of_the_solver():
    # A neuron with one half open synapse: tau = C / (G + w g); a step divides its distance to rest.
    circuit = build_circuit("two", ("a", "b"), [(SynapseKind.EXCITATORY, 0, 1, 2.0)])
    potentials = np.array([-40.0, -70.0])
    tau = time_constants(circuit, potentials)
    assert tau[1] == pytest.approx(0.05 / (1.0 + 2.0 * 0.5))
    rest = 1.0 * -70.0 / 2.0
    after = reference.step(circuit, potentials, 0.01)
    assert after[1] - rest == pytest.approx((potentials[1] - rest) / (1 + 0.01 / tau[1]))
