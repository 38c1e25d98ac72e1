"""CfC and LTC in lanes against the library ncps, and the circuit's solver against its unrolled form.

They need the extra ``liquid``: make test-torch runs them.
"""

import numpy as np
import pytest

from rover_ncp.circuit.policy import PolicyRunner
from sim.learn.commander import CommanderRunner
from sim.learn.networks import network_commander
from sim.paper import BudgetName
from sim.paper.agents import build_agent, untuned
from sim.paper.results import RunName
from sim.paper.runs import agrees, replay, train_run
from sim.paper.tasks import TASKS

torch = pytest.importorskip("torch", reason="needs the extra liquid; make test-torch runs it")


@pytest.mark.parametrize("task", ["mountain-car", "parking"])
@pytest.mark.parametrize("kind", ["cfc", "ltc", "circuit"])
def test_a_kernel_computes_what_torch_does(kind, task):
    from sim.paper import unrolled

    agent, net = (build_agent(TASKS[task], name, 0) for name in (kind, "mlp"))
    rng, varied = np.random.default_rng(5), 0.0
    for vector in untuned(agent, rng, 6):
        seen = rng.uniform(-1.2, 1.2, (30, len(net.scale))) * net.scale
        if kind == "circuit":
            runner = PolicyRunner(agent.with_parameters(vector))
        else:
            runner = CommanderRunner(network_commander(agent), vector)
        got = np.array([runner.tick(row)[: len(net.high)] for row in seen])
        student = unrolled.student_of(agent, vector)
        np.testing.assert_allclose(student.vector(), vector, rtol=1e-12, atol=1e-14)
        z = student.outputs(torch.from_numpy(seen[None]), None, 0.0)[0][0].detach().numpy()
        low, high = np.array(net.low), np.array(net.high)
        expected = np.clip(z * np.maximum(high, -low), low, high)
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-12)
        varied += np.ptp(got, axis=0)
    assert np.all(varied > 0.01)


@pytest.mark.parametrize("task", ["mountain-car", "parking"])
@pytest.mark.parametrize("name", ["circuit", "cfc", "ltc"])
def test_a_gradient_brings_an_agent_nearer_to_the_law(name, task):
    from sim.paper import cloning, unrolled

    lesson_of = cloning.CarLesson if task == "mountain-car" else cloning.ParkingLesson
    agent = build_agent(TASKS[task], f"{name}-cloned", 0)
    lesson = lesson_of(TASKS[task], agent, 1)
    data = [torch.from_numpy(part[:2]) for part in lesson.collect(0, None)]
    student = unrolled.student_of(agent, lesson.start)
    optimizer = torch.optim.Adam(student.parameters, lr=0.02)

    def miss():
        with torch.no_grad():
            z, _ = student.outputs(data[0], None, 1.0)
        return float((data[2] * (z - data[1]) ** 2).mean())

    first = miss()
    for _ in range(3):
        cloning.descend(student, optimizer, data, 40, 1.0)
    assert miss() < 0.95 * first
    layout, vector = agent.layout(), student.vector()
    assert np.all((vector >= layout.lower) & (vector <= layout.upper))


def test_a_run_by_gradient_replays_and_counts_its_steps():
    result = train_run(RunName(task="parking", agent="cfc-cloned", seed=1, budget=BudgetName.QUICK))
    rounds, judged, candidates = 2 * 8, 1 + 2 + 2, 8 * 16
    assert result.steps == 320 * (rounds + judged + candidates)
    assert result.settings["cloned_steps"] == 320 * (rounds + 1 + 2)
    assert {"torch", "ncps"} <= set(result.made_with)
    assert agrees(result, replay(result))
