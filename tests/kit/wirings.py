"""Policies on any wiring, for tests of what runs them."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from rover_ncp.circuit.circuit import DEFAULTS, Circuit, ParameterKind, SynapseKind
from rover_ncp.circuit.motors import Motors
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.sensing import Channel, Sensing


def unit_vectors(size):
    """Vectors in [0, 1]: where in their bounds parameters lie; the bounds themselves are likely."""
    return hnp.arrays(np.float64, size, elements=st.floats(0, 1) | st.sampled_from([0.0, 1.0]))


def in_bounds(policy, unit):
    layout = policy.layout()
    return np.clip(layout.lower + unit * (layout.upper - layout.lower), layout.lower, layout.upper)


@st.composite
def wirings(draw):
    """Policies on any wiring of up to 8 neurons, loops and synapses into sensory neurons included."""
    count = draw(st.integers(4, 8))
    neuron = st.integers(0, count - 1)
    synapse = st.tuples(st.sampled_from(SynapseKind), neuron, neuron)
    synapses = draw(st.lists(synapse, max_size=24, unique=True))
    circuit = build_circuit("any", [f"n{i}" for i in range(count)], [(*row, 1.0) for row in synapses])
    if draw(st.booleans()):
        object.__setattr__(circuit, "held", {3: draw(st.floats(-90, 0)), 0: -10.0})
    layered = draw(st.booleans())
    sensing = Sensing(
        name="any",
        inputs=("a", "b", "c") if layered else ("a", "b"),
        channels=(
            Channel(name="a", positive="n0", maximum=1.0, negative="n1", minimum=-0.5),
            Channel(name="b", positive="n2", maximum=2.0),
        ),
        clamp=draw(st.booleans()),
    )
    motors = Motors(
        outputs=("u", "v", "w") if layered else ("u", "v"),
        channels=(
            Channel(name="u", positive="n3", maximum=1.0, negative="n0", minimum=-1.0),
            Channel(name="v", negative="n3", minimum=-0.5),
        ),
    )
    layers = {"input_layer": np.zeros((2, 3)), "output_layer": np.zeros((3, 2))} if layered else {}
    policy = Policy(circuit, sensing, motors, **layers)
    return policy.with_parameters(in_bounds(policy, draw(unit_vectors(policy.layout().size))))


def build_circuit(name, neurons, synapses, sigma=DEFAULTS[ParameterKind.SIGMA]):
    """Build a circuit from rows (kind, source, destination, weight in S), everything else at its default."""
    n, m = len(neurons), len(synapses)
    columns = [np.array([row[i] for row in synapses], np.int64).reshape(m) for i in range(3)]
    return Circuit(
        name=name,
        neurons=tuple(neurons),
        kind=columns[0],
        source=columns[1],
        destination=columns[2],
        weight=np.array([row[3] for row in synapses], np.float64).reshape(m),
        sigma=np.broadcast_to(np.asarray(sigma, np.float64), (m,)),
        leak_potential=np.full(n, DEFAULTS[ParameterKind.LEAK_POTENTIAL]),
        leak=np.full(n, DEFAULTS[ParameterKind.LEAK]),
        capacitance=np.full(n, DEFAULTS[ParameterKind.CAPACITANCE]),
    )
