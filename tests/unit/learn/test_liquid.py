"""CfC and LTC in lanes against the library ncps, and the circuit's solver against its unrolled form.

They need the extra ``liquid``: make test-torch runs them.
"""

import numpy as np
import pytest

from rover_ncp.circuit.policy import PolicyRunner
from sim.learn.commander import CommanderRunner
from sim.learn.networks import network_commander
from sim.paper.agents import build_agent, untuned
from sim.paper.tasks import TASKS

torch = pytest.importorskip("torch", reason="needs the extra liquid; make test-torch runs it")


@pytest.mark.parametrize("task", ["mountain-car", "parking"])
@pytest.mark.parametrize("kind", ["cfc", "ltc", "circuit"])
def test_a_kernel_computes_what_torch_does(kind, task, monkeypatch):
    from sim.paper import unrolled

    monkeypatch.setattr(unrolled, "_BEYOND", 0.0)  # a motor neuron's end, as the solver has it

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
        z = student.outputs(torch.from_numpy(seen[None]), None)[0][0].detach().numpy()
        low, high = np.array(net.low), np.array(net.high)
        expected = np.clip(z * np.maximum(high, -low), low, high)
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-12)
        varied += np.ptp(got, axis=0)
    assert np.all(varied > 0.01)
