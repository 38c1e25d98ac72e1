"""Trained agents on the benchmarks under noise, delay and lost inputs, as curves.

noise   Gaussian, its deviation as a share of the input's range
delay   observations that are older by so many control ticks
loss    share of the ticks on which no new observation arrives: the agent sees the last one again

Nothing is trained again. Pendulums are the written ones.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rover_ncp.kernels.jit import kernel
from sim.learn.curve import png_of
from sim.learn.networks import NetKind, net_for
from sim.learn.search.base import Seeds, Vector, draw_seeds
from sim.paper.agents import build_agent
from sim.paper.evaluator import commander_for, first_states, make_plants
from sim.paper.plants.lanes import Plants, observe, reset_plant, step_plant
from sim.paper.results import ResultStore
from sim.paper.tables import markdown
from sim.paper.tasks import TASKS, Benchmark

LEVELS = {
    "noise": (0.0, 0.02, 0.05, 0.1, 0.2, 0.4),
    "delay": (0, 1, 2, 3, 5, 8),
    "loss": (0.0, 0.1, 0.2, 0.4, 0.6, 0.8),
}
_AGENTS = {
    "circuit": "tab:blue",
    "mlp": "tab:green",
    "lstm": "tab:red",
    "cfc": "tab:purple",
    "ltc": "tab:brown",
}
"""Agents and their colors."""
_EPISODES, _CHEETAH_EPISODES = 10, 2
_SEED = 32


@kernel
def observe_lanes(plants: Plants, observations: Vector) -> None:
    """Write all observations into (inputs, L)."""
    for lane in range(observations.shape[1]):
        observe(plants, lane, observations)


@kernel
def step_lanes(plants: Plants, commands: Vector, running: NDArray[np.bool_], totals: Vector) -> int:
    """Step the plants whose episode runs, add their rewards to (L,); return how many still run."""
    left = 0
    for lane in range(commands.shape[1]):
        if running[lane]:
            reward, _, terminated = step_plant(plants, lane, commands)
            totals[lane] += reward
            running[lane] = not terminated
            left += running[lane]
    return left


def disturbed_returns(
    task: Benchmark, agent: str, vectors: Vector, seeds: Seeds, disturbance: tuple[str, float]
) -> Vector:
    """Return Gymnasium's returns (L,) of vectors (L, P) in episodes of seeds (L,), with kind and level."""
    commander, (inputs, outputs) = commander_for(build_agent(task, agent, 0))
    (kind, level), count = disturbance, len(vectors)
    plants, pool = make_plants(task, count, for_search=True)
    arrays = commander.allocate(count)
    for lane, (vector, start) in enumerate(zip(vectors, first_states(task, seeds), strict=True)):
        commander.start_lane(arrays, lane, np.ascontiguousarray(vector))
        reset_plant(plants, lane, start)
    scale = np.array(net_for(task.policy(task.circuit()), NetKind.MLP).scale)
    rng = np.random.default_rng(_SEED)
    running, totals = np.ones(count, np.bool_), np.zeros(count)
    fresh, commands = np.zeros((inputs, count)), np.zeros((outputs, count))
    history: list[Vector] = []
    for _ in range(task.horizon):
        observe_lanes(plants, fresh)
        seen = fresh.copy()
        if kind == "noise":
            seen += level * scale[:, None] * rng.standard_normal(seen.shape)
        elif kind == "loss" and history:
            seen = np.where(rng.random(count) < level, history[-1], seen)
        history = [*history, seen][-1 - (int(level) if kind == "delay" else 0) :]
        commander.tick_lanes(arrays, np.ascontiguousarray(history[0]), commands)
        if step_lanes(plants, commands, running, totals) == 0:
            break
    del pool  # kept alive until here: it owns MuJoCo's memory
    return totals


def disturbance_study(store: ResultStore, tasks: Sequence[str]) -> list[dict[str, Any]]:
    """Return mean and deviation over runs for each task, agent, kind of disturbance and level."""
    rows = []
    for name in tasks:
        task = TASKS[name]
        if not isinstance(task, Benchmark):
            continue
        episodes = _CHEETAH_EPISODES if name == "half-cheetah" else _EPISODES
        for agent in _AGENTS:
            results = store.results(name, agent)
            if not results:
                continue
            vectors = np.repeat([result.parameters.array() for result in results], episodes, axis=0)
            seeds = np.tile(draw_seeds(_SEED, (), episodes), len(results))
            for kind, levels in LEVELS.items():
                for level in levels:
                    returns = disturbed_returns(task, agent, vectors, seeds, (kind, level))
                    means = returns.reshape(len(results), episodes).mean(axis=1)
                    rows.append(
                        {
                            "task": name,
                            "agent": agent,
                            "kind": kind,  #: noise, delay or loss
                            "level": level,  #: share of a range, ticks, or share of ticks
                            "runs": len(results),  #: how many
                            "mean": float(means.mean()),  #: return without bonus
                            "std": float(means.std(ddof=min(len(means) - 1, 1))),  #: over runs
                            "succeed": int(np.sum(means >= task.success)),  #: how many runs still do
                        }
                    )
    return rows


def disturbances_text(rows: Sequence[dict[str, Any]]) -> str:
    """Return the study as Markdown: the runs that still succeed, level by level."""
    table: list[tuple[str, ...]] = [
        ("task", "agent", *(f"{kind} {', '.join(map(str, levels))}" for kind, levels in LEVELS.items()))
    ]
    for task, agent in dict.fromkeys((row["task"], row["agent"]) for row in rows):
        own = [row for row in rows if (row["task"], row["agent"]) == (task, agent)]
        cells = (
            ", ".join(f"{row['succeed']}" for row in own if row["kind"] == kind) + f" of {own[0]['runs']}"
            for kind in LEVELS
        )
        table.append((TASKS[task].title, agent, *cells))
    return markdown(table)


def disturbances_png(rows: Sequence[dict[str, Any]]) -> bytes:
    """Return mean returns over the level of each disturbance as PNG, a row for each task."""
    from matplotlib.figure import Figure

    tasks = list(dict.fromkeys(row["task"] for row in rows))
    figure = Figure(figsize=(9.0, 1.9 * len(tasks)), dpi=80, layout="constrained")
    grid: Any = figure.subplots(len(tasks), len(LEVELS), squeeze=False, sharey="row")
    for panels, task in zip(grid, tasks, strict=True):
        for axes, kind in zip(panels, LEVELS, strict=True):
            for agent, color in _AGENTS.items():
                own = [row for row in rows if (row["task"], row["agent"], row["kind"]) == (task, agent, kind)]
                if not own:
                    continue
                levels, means, spreads = np.array([(row["level"], row["mean"], row["std"]) for row in own]).T
                axes.fill_between(
                    levels, means - spreads, means + spreads, color=color, alpha=0.15, linewidth=0
                )
                axes.plot(levels, means, color=color, linewidth=1.2, label=f"{agent} ({own[0]['runs']})")
            axes.axhline(TASKS[task].success, color="0.6", linewidth=0.8, linestyle=":")
            axes.set_title(f"{task}: {kind}", fontsize=7)
            axes.tick_params(labelsize=7)
            axes.grid(alpha=0.3)
        panels[0].legend(fontsize=6, loc="lower left")
    figure.supylabel("return without bonus", fontsize=9)
    return png_of(figure)
