import numpy as np
import pytest
from kit.wirings import build_circuit

from rover_ncp.circuit.circuit import SynapseKind
from rover_ncp.circuit.motors import Motors
from rover_ncp.circuit.policy import Policy, course_policy, parking_policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.circuit.sensing import Channel, Sensing
from rover_ncp.course.course import load_course
from rover_ncp.neurons.findings import analyse
from rover_ncp.neurons.phases import Mean, explain, phases
from rover_ncp.neurons.trace import Trace, motor_outputs, motor_shares
from sim.explain.explain import traced
from sim.learn.rollout import rollout

EX, IN = SynapseKind.EXCITATORY, SynapseKind.INHIBITORY


def small_policy():
    """x drives A, which lifts L (left) and holds B down; B lifts R (right); F (forward) has no synapse."""
    circuit = build_circuit(
        "small",
        ["X", "A", "B", "L", "R", "F"],
        [(EX, 0, 1, 2.0), (IN, 1, 2, 2.0), (EX, 1, 3, 3.0), (EX, 2, 4, 3.0)],
    )
    sensing = Sensing(name="one", inputs=("x",), channels=(Channel(name="x", positive="X", maximum=1.0),))
    motors = Motors(
        outputs=("v", "omega"),
        channels=(
            Channel(name="v", positive="F", maximum=0.16),
            Channel(name="omega", positive="L", maximum=0.18, negative="R", minimum=-0.18),
        ),
    )
    return Policy(circuit, sensing, motors)


def trace_of(commands, potentials=None, policy=None):
    policy = policy or small_policy()
    count = len(commands)
    if potentials is None:
        potentials = np.full((count, policy.circuit.size), -70.0)
    commands = np.array(commands, float)
    v, omega = 0.1 * commands.T
    theta = np.cumsum([0.0, *omega])
    x, y = (np.cumsum([0.0, *v * way(theta[:-1])]) for way in (np.cos, np.sin))
    poses = np.column_stack([x, y, theta])
    return Trace(policy, 0.1 * np.arange(count), poses, commands, np.array(potentials, float))


STAND, AHEAD, LEFT, RIGHT, SPIN = (0, 0), (0.1, 0), (0.1, 0.15), (0.1, -0.15), (0, 0.15)


def test_phases_are_the_signs_of_the_commands():
    found = phases(trace_of([STAND] * 10 + [AHEAD] * 20 + [LEFT] * 30 + [RIGHT] * 10 + [SPIN] * 10))
    assert [phase.label for phase in found] == [
        "standing still",
        "straight ahead",
        "left turn",
        "right turn",
        "left turn on the spot",
    ]
    assert [p.start_s for p in found] == pytest.approx([0, 1, 3, 6, 7])
    assert [p.end_s for p in found] == pytest.approx([1, 3, 6, 7, 8])
    assert [p.driven_m for p in found] == pytest.approx([0, 0.2, 0.3, 0.1, 0])
    assert [p.turned_rad for p in found] == pytest.approx([0, 0, 0.45, -0.15, 0.15])


def test_short_phase_is_merged_with_its_longer_neighbour():
    found = phases(trace_of([LEFT] * 20 + [AHEAD] * 4 + [RIGHT] * 10))
    assert [(p.label, p.first, p.last) for p in found] == [("left turn", 0, 24), ("right turn", 24, 34)]
    alternating = [LEFT, RIGHT] * 8 + [AHEAD] * 6
    found = phases(trace_of(alternating))
    assert [p.first for p in found[1:]] == [p.last for p in found[:-1]]
    assert (found[0].first, found[-1].last) == (0, len(alternating))
    assert phases(trace_of(np.zeros((0, 2)))) == ()


@pytest.mark.parametrize("make", [parking_policy, course_policy])
def test_motor_outputs_are_the_commands_of_the_run(make):
    policy = make(load_circuit("parking") if make is parking_policy else load_circuit("tap_withdrawal"))
    layout = policy.layout()
    policy = policy.with_parameters(np.random.default_rng(0).uniform(layout.lower, layout.upper))
    run = rollout(policy, load_course("parking"))
    assert motor_outputs(policy, run.potentials) == pytest.approx(run.commands, abs=1e-12)
    if policy.motors.limits is None:
        shares = sum(share for _, share in motor_shares(policy, run.potentials))
        assert shares == pytest.approx(run.commands, abs=1e-12)
    motors = {neuron for channel in policy.motors.channels for neuron, _ in channel.sides}
    assert {part.motor.neuron for part in explain(traced(policy, run))} <= motors


def test_a_left_turn_is_explained_from_its_numbers():
    #        X    A    B    L    R    F
    rest = [-70, -70, -70, -70, -70, -30]
    turn = [-20, -30, -80, -25, -60, -30]
    found = analyse(trace_of([AHEAD] * 10 + [LEFT] * 10, [rest] * 10 + [turn] * 10))
    ahead, left = found.phases
    assert (ahead.motor.neuron, ahead.behind) == ("F", None)
    assert ahead.sentence == "Straight ahead 0.0 to 1.0 s (0.10 m): F at −30 mV by its own leak."
    assert (left.motor, left.behind) == (Mean(neuron="L", mean_mV=-25), Mean(neuron="A", mean_mV=-30))
    # By hand: A rests at -70 mV with 1 S; X at -20 mV opens 2 S by 1 / (1 + exp(-0.1 * 20)) = 0.8808.
    pull = -70 / (1 + 2 * 0.880797) + 70
    assert [(each.neuron, each.mean_mV) for each in left.pulls] == [("X", pytest.approx(pull))]
    before = -70 / (1 + 2 * 0.047426) + 70  # X at -70 mV
    assert left.change.neuron == "X"
    assert (left.change.before_mV, left.change.now_mV) == pytest.approx((before, pull), abs=1e-4)
    assert left.sentence == (
        "Left turn 1.0 to 2.0 s (0.10 m, +9°): A (−30 mV; its synapse 73 % open), driven by X [x] (+45 mV); "
        "it puts L at −25 mV. What changed: the pull of X [x] on A grew from +6 mV to +45 mV."
    )
