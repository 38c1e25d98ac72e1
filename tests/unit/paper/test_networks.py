"""Networks: their equations, and their sizes."""

import gymnasium
import numpy as np
import pytest

from paper.episodes import PlantEvaluator
from paper.tasks import TASKS, build_agent


def textbook(net, vector):
    """Return a function from an observation to a network's commands, tick by tick."""
    first, last = np.split(vector, [net.sizes[0]])
    hidden_rows, output_rows = first.reshape(net.gates, net.cells, -1), last.reshape(net.outputs, -1)
    hidden = memory = np.zeros(net.cells)

    def act(seen):
        nonlocal hidden, memory
        if net.kind == "mlp":
            hidden = np.tanh(hidden_rows[0] @ [*seen, 1.0])
        else:
            i, f, g, o = hidden_rows @ [*seen, *hidden, 1.0]
            i, f, o = (1.0 / (1.0 + np.exp(-gate)) for gate in (i, f, o))
            memory = f * memory + i * np.tanh(g)
            hidden = o * np.tanh(memory)
        return np.clip(output_rows @ [*hidden, 1.0], -1.0, 1.0)

    return act


@pytest.mark.parametrize("kind", ["mlp", "lstm"])
@pytest.mark.parametrize("name", ["mountain-car", "half-cheetah"])
def test_an_episode_is_that_of_the_textbooks_network_in_gymnasiums_environment(kind, name):
    task = TASKS[name].model_copy(update={"horizon": 10})
    net, seeds = build_agent(task, kind, 0), np.arange(11, dtype=np.uint64)
    vectors = np.random.default_rng(1).normal(0.0, 0.4, (len(seeds), sum(net.sizes)))
    env = gymnasium.make(task.environment)
    expected = []
    for vector, seed in zip(vectors, seeds.tolist(), strict=True):
        seen, _ = env.reset(seed=seed)
        act, total = textbook(net, vector), 0.0
        for _ in range(task.horizon):
            seen, reward, *_ = env.step(act(seen))
            total += reward
        expected.append(total)
    assert PlantEvaluator(task, net).run(vectors, seeds)[:, 0] == pytest.approx(expected, rel=1e-9)


def test_networks_are_those_of_the_published_code():
    mlp, lstm = (build_agent(TASKS["pendulum"], kind, 0) for kind in ("mlp", "lstm"))
    assert mlp.sizes == (12 * (2 + 1), 12 + 1)
    assert lstm.sizes == (4 * 12 * (2 + 12 + 1), 12 + 1)
