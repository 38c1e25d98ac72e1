"""CfC and LTC in lanes against the cells of the library ncps: make test-torch."""

import numpy as np
import pytest

from benchmarks.liquid import BACKBONE, PARTS, liquid_lane_runner, liquid_net_for
from sim.learn.engine.lane_runner import OneLaneRunner
from sim.learn.search.random_search import perturb
from sim.paper.tasks import TASKS

torch = pytest.importorskip("torch", reason="make test-torch installs torch")


def library_outputs(net, vector, seen):
    """Return the outputs (T, outputs) of the library's cell with parameters (P,) for observations."""
    from ncps.torch import LTC, CfC
    from ncps.wirings import FullyConnected
    from torch.nn.utils import vector_to_parameters

    like = net.like
    inputs, outputs = len(like.scale), len(like.high)
    if net.kind == "cfc":
        module = CfC(inputs, like.cells, proj_size=outputs, backbone_units=BACKBONE)
    else:
        module = LTC(inputs, FullyConnected(like.cells, outputs), implicit_param_constraints=False)
    module = module.double()
    named = dict(module.named_parameters())
    parameters = [named[tensor.name] for part in net.parts for tensor in part.tensors]
    vector_to_parameters(torch.from_numpy(vector.copy()), parameters)
    most = np.array(like.most)
    part = np.clip((seen - np.array(like.center)) / np.array(like.scale), -most, most)
    with torch.no_grad():
        z, _ = module(torch.from_numpy(part[None]), torch.zeros(1, like.cells, dtype=torch.float64))
    low, high = np.array(like.low), np.array(like.high)
    return np.clip(z[0].numpy() * np.maximum(high, -low), low, high)


@pytest.mark.parametrize("task", ["mountain-car", "parking"])
@pytest.mark.parametrize("kind", PARTS)
def test_kernel_computes_what_the_library_does(kind, task):
    net = liquid_net_for(TASKS[task].policy(TASKS[task].circuit()), kind)
    rng, varied = np.random.default_rng(5), 0.0
    for _ in range(6):
        vector = perturb(net.layout(), net.start(rng), rng)
        seen = rng.uniform(-1.2, 1.2, (30, len(net.like.scale))) * net.like.scale
        runner = OneLaneRunner(liquid_lane_runner(net), vector)
        got = np.array([runner.tick(row)[: len(net.like.high)] for row in seen])
        np.testing.assert_allclose(got, library_outputs(net, vector, seen), rtol=1e-9, atol=1e-12)
        varied += np.ptp(got, axis=0)
    assert np.all(varied > 0.01)
