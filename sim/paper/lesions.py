"""Lesions of the trained circuits: each neuron, and each synapse, taken out in turn.

A lesion sets the weights of a synapse, or of all synapses from and to a neuron, to zero; nothing is trained
again. Pendulums are the written ones.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.policy import Policy
from sim.learn.curve import png_of
from sim.learn.search.base import Vector, draw_seeds
from sim.paper.evaluator import Evaluator
from sim.paper.search.parking import ParkingEvaluator
from sim.paper.results import ResultStore
from sim.paper.statistics import mean_text
from sim.paper.tables import markdown
from sim.paper.tasks import TASKS, Benchmark, Task

_EPISODES, _CHEETAH_EPISODES = 10, 3
_SEED = 31
INTACT = "intact"


def lesioned(policy: Policy, vector: Vector) -> dict[str, Vector]:
    """Return the parameters (P,) of a circuit by what was taken out: nothing, a neuron, a synapse."""
    circuit, weights = policy.circuit, policy.layout().block(ParameterKind.WEIGHT).slice
    parts = {INTACT: np.zeros(circuit.synapse_count, np.bool_)}
    for index, neuron in enumerate(circuit.neurons):
        parts[neuron] = (circuit.source == index) | (circuit.destination == index)
    for index in range(circuit.synapse_count):
        parts[circuit.label(index)] = np.arange(circuit.synapse_count) == index
    found = {}
    for name, out in parts.items():
        found[name] = vector.copy()
        found[name][weights] = np.where(out, 0.0, vector[weights])
    return found


def lesion_study(store: ResultStore, tasks: Sequence[str]) -> list[dict[str, Any]]:
    """Return, for each task and part: mean return of the circuits without it, and how many still succeed."""
    rows = []
    for name in tasks:
        task = TASKS[name]
        policy = task.policy(task.circuit())
        results = store.results(name, "circuit")
        damaged = [lesioned(policy, result.parameters.array()) for result in results]
        if not damaged:
            continue
        parts = list(damaged[0])
        returns, successes = _outcomes(task, policy, np.array([list(each.values()) for each in damaged]))
        for number, part in enumerate(parts):
            rows.append(
                {
                    "task": name,
                    "part": part,  #: that was taken out
                    "neuron": part in policy.circuit.neurons,  #: whether the part is one
                    "circuits": len(results),  #: how many
                    "mean": float(returns[:, number].mean()),  #: return without bonus
                    "succeed": int(successes[:, number].sum()),  #: how many circuits still do
                }
            )
    return rows


def _outcomes(task: Task, policy: Policy, vectors: Vector) -> tuple[Vector, NDArray[np.bool_]]:
    """Return mean return, without bonus, and success (circuits, parts) of vectors (circuits, parts, P)."""
    rows, shape = vectors.reshape(-1, vectors.shape[-1]), vectors.shape[:2]
    if not isinstance(task, Benchmark):
        found = ParkingEvaluator(task, policy).engine.outcomes(rows)
        returns = found.total[:, 0].reshape(shape)
        return returns, found.parked[:, 0].reshape(shape) & (returns >= task.success)
    evaluator = Evaluator(task, policy, for_search=True)
    seeds = draw_seeds(_SEED, (), _CHEETAH_EPISODES if task.name == "half-cheetah" else _EPISODES)
    plain = evaluator.run(np.repeat(rows, len(seeds), axis=0), np.tile(seeds, len(rows)))[:, 0]
    means = plain.reshape(*shape, len(seeds)).mean(axis=2)
    return means, means >= task.success


def lesions_text(rows: Sequence[dict[str, Any]]) -> str:
    """Return the study as Markdown: for each task the parts without which the fewest circuits succeed."""
    table: list[tuple[str, ...]] = [
        ("task", "intact", "neurons that none does without", "synapses that none does without")
    ]
    for task in dict.fromkeys(row["task"] for row in rows):
        own = [row for row in rows if row["task"] == task]
        lost = [row for row in own if row["succeed"] == 0]
        table.append(
            (
                TASKS[task].title,
                f"{own[0]['succeed']} of {own[0]['circuits']}, {mean_text(own[0]['mean'])}",
                ", ".join(row["part"] for row in lost if row["neuron"]) or "none",
                ", ".join(row["part"] for row in lost if not row["neuron"]) or "none",
            )
        )
    return markdown(table)


def lesions_png(rows: Sequence[dict[str, Any]]) -> bytes:
    """Return the share of circuits that still succeed, for each part and task, as PNG."""
    from matplotlib.figure import Figure

    tasks = list(dict.fromkeys(row["task"] for row in rows))
    parts = list(dict.fromkeys(row["part"] for row in sorted(rows, key=lambda row: not row["neuron"])))
    parts = [INTACT, *(part for part in parts if part != INTACT)]
    shares = np.full((len(parts), len(tasks)), np.nan)
    for row in rows:
        shares[parts.index(row["part"]), tasks.index(row["task"])] = row["succeed"] / row["circuits"]
    figure = Figure(figsize=(7.0, 0.18 * len(parts) + 1.5), dpi=100, layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(shares, cmap="viridis", vmin=0.0, vmax=1.0, aspect="auto")
    axes.set_xticks(range(len(tasks)), tasks, rotation=45, ha="right", fontsize=8)
    axes.set_yticks(range(len(parts)), parts, fontsize=7)
    figure.colorbar(image, label="share of the circuits that still succeed")
    return png_of(figure)
