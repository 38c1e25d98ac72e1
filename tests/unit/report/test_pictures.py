import numpy as np
import pytest

from deploy.report.analysis import analyse
from deploy.report.charts.bars import Outcome, Swing, outcomes, swings
from deploy.report.charts.circuit import circuit
from deploy.report.charts.files import tables
from deploy.report.layout import HEIGHT, RADIUS, WIDTH, Layer, lay_out, layers
from rover_ncp.circuit.circuit import SynapseKind, build_circuit
from rover_ncp.circuit.policy import Policy, parking_policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.circuit.sensing import parking_sensing
from rover_ncp.circuit.tap_withdrawal import PARKING_NEURONS, parking_circuit
from rover_ncp.course.course import load_course
from sim.explain.explain import traced
from sim.learn.rollout import rollout

PARKING = parking_policy(parking_circuit())


@pytest.fixture(scope="module")
def short():
    policy, course = load_policy("parking"), load_course("tests/data/short_course.yaml")
    return analyse(traced(policy, rollout(policy, course))), course


def test_layers_of_the_parking_circuit():
    found = dict(zip(PARKING_NEURONS, layers(PARKING), strict=True))
    assert [name for name, layer in found.items() if layer is Layer.SENSORY] == ["PVD", "PLM", "AVM", "ALM"]
    assert [name for name, layer in found.items() if layer is Layer.INTER] == ["AVD", "PVC", "DVA"]
    assert [name for name, layer in found.items() if layer is Layer.COMMAND] == ["AVA", "AVB"]
    assert [name for name, layer in found.items() if layer is Layer.MOTOR] == ["LFT", "RGT", "FWD"]


def curve_points(curve):
    t = np.linspace(0, 1, 50)[:, None]
    a, c, b = (np.array(curve[i : i + 2]) for i in (0, 2, 4))
    return (1 - t) ** 2 * a + 2 * t * (1 - t) * c + t**2 * b


def random_policy(seed):
    rng = np.random.default_rng(seed)
    pairs = [(i, j) for i in range(12) for j in (2, 3, 4, 5, 8, 9, 10, 11)]
    chosen = rng.choice(len(pairs), 28, replace=False)
    rows = [(SynapseKind(rng.integers(3)), *pairs[k], 1.0) for k in chosen]
    return parking_policy(build_circuit("random", PARKING_NEURONS, rows))


@pytest.mark.parametrize("policy", [PARKING, random_policy(1), random_policy(2)], ids=["parking", "r1", "r2"])
def test_no_synapse_runs_through_a_foreign_neuron(policy):
    layout, wiring = lay_out(policy), policy.circuit
    places = np.array(layout.places)
    assert (places >= RADIUS).all()
    assert (places <= [WIDTH - RADIUS, HEIGHT - RADIUS]).all()
    through = 0
    for curve, ends in zip(layout.curves, zip(wiring.source, wiring.destination, strict=True), strict=True):
        for neuron in set(range(wiring.size)) - set(map(int, ends)):
            through += np.hypot(*(curve_points(curve) - places[neuron]).T).min() < RADIUS
    # The wiring that people look at is clean; a random one may need a synapse or two across.
    assert through <= (0 if policy is PARKING else 3)


def test_every_synapse_of_the_parking_circuit_has_a_way_of_its_own():
    curves = [curve_points(curve)[10:-10] for curve in lay_out(PARKING).curves]
    for i, one in enumerate(curves):
        for other in curves[:i]:
            apart = np.hypot(*(one[:, None] - other[None]).transpose(2, 0, 1)).min(axis=1)
            assert np.mean(apart < 4.0) < 0.5


def test_left_is_left():
    places = dict(zip(PARKING_NEURONS, lay_out(PARKING).places, strict=True))
    assert places["LFT"][0] < places["RGT"][0]


def test_the_same_circuit_gives_the_same_drawing():
    assert lay_out(PARKING) == lay_out(parking_policy(parking_circuit()))


def test_a_synapse_of_a_neuron_on_itself_is_drawn():
    looped = build_circuit("loop", PARKING_NEURONS, [(SynapseKind.EXCITATORY, 2, 2, 1.0)])
    curve = lay_out(parking_policy(looped)).curves[0]
    assert np.hypot(curve.x0 - curve.x1, curve.y0 - curve.y1) > 5


def test_a_picture_is_the_same_each_time(short):
    analysis, _ = short
    assert circuit(analysis.trace, analysis.time_constants) == circuit(
        analysis.trace, analysis.time_constants
    )


def test_pictures_of_what_ifs(short):
    rows = [Outcome("neuron A", 0.5, -9.0, False), Outcome("excitatory A -> B", 0.02, -0.03, True)]
    assert outcomes(rows, Outcome("intact", 0.03, -0.03, True), 0.1, "t").png.startswith(b"\x89PNG")
    assert swings([Swing("leak, A", -0.1, 0.002)], "t").png.startswith(b"\x89PNG")


def test_tables_hold_every_pair_neuron_and_phase(short):
    analysis, _ = short
    found = {name: text.splitlines() for name, text in tables(analysis).items()}
    assert len(found["contributions"]) == 1 + 12 * 11
    assert len(found["potentials"]) == 1 + len(analysis.trace.times)
    assert len(found["time_constants"]) == 1 + 8
    assert len(found["phases"]) == 1 + len(analysis.explanations)
    header = found["contributions"][0].split(",")
    row = dict(
        zip(
            header, next(r for r in found["contributions"] if r.startswith("AVA,RGT")).split(","), strict=True
        )
    )
    counts = analysis.contributions["AVA", "RGT"]
    assert (row["sign"], int(row["P"]), int(row["Q"])) == (
        counts.sign,
        counts.positive,
        counts.negative,
    )
    assert row["paper_sign"] == "positive"
    assert sum(int(row[f"bin_{k}"]) for k in range(10)) == sum(counts.bins)


def test_a_circuit_without_inter_neurons_is_drawn():
    direct = build_circuit("direct", PARKING_NEURONS, [(SynapseKind.EXCITATORY, 0, 9, 1.0)])
    policy = Policy(direct, parking_sensing(), PARKING.motors)
    # PVD feeds a motor neuron, yet what is sensory stays in the first row.
    assert layers(policy)[0] is Layer.SENSORY
    assert len(lay_out(policy).curves) == 1
