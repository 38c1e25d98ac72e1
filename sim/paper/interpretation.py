"""Interpretation of the trained parking circuits: time constants and contributions, beside the paper's."""

from collections import Counter
from typing import Any

from deploy.report.interpretation import (
    PUBLISHED_SIGNS,
    PUBLISHED_TIME_CONSTANTS_S,
    contributions,
    time_constant_ranges,
)
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import UsageError
from rover_ncp.course.course import load_course
from sim.learn.engine.rollout import Rollout, rollout
from sim.paper.agents import build_agent
from sim.paper.play import BenchmarkEpisodes
from sim.paper.results import ResultStore
from sim.paper.tables import markdown
from sim.paper.tasks import Benchmark, find_task

BENCHMARK_TIME_CONSTANTS_S: dict[str, dict[str, tuple[float, float]]] = {
    "pendulum": {
        "DVA": (9.7e-4, 2.5e-3),
        "PVC": (0.043, 0.71),
        "AVD": (0.037, 0.11),
        "AVB": (4.6e-3, 4.6e-3),
        "AVA": (2.4e-4, 3.9e-4),
        "FWD": (3.7e-4, 2.4e-3),
        "REV": (8.7e-3, 8.7e-3),
    },
    "mountain-car": {
        "DVA": (0.5, 6.49),
        "PVC": (0.11, 0.3),
        "AVD": (1.32e-4, 4.75e-4),
        "AVB": (0.05, 4.62),
        "AVA": (0.014, 0.087),
        "FWD": (0.069, 2.95),
        "REV": (0.47, 0.47),
    },
}
"""Smallest and largest over the paper's other runs (Table S7)."""


def benchmark_time_constants(store: ResultStore, name: str) -> dict[str, tuple[float, float]]:
    """Return the time constants in s of the best circuit of a benchmark, over one episode, by neuron."""
    task = find_task(name)
    assert isinstance(task, Benchmark)
    best = max(store.results(name, "circuit"), key=lambda result: result.mean)
    untrained = build_agent(task, "circuit", best.name.seed)
    assert isinstance(untrained, Policy)
    policy = untrained.with_parameters(best.parameters.array())
    potentials = BenchmarkEpisodes(task, policy).play(0).potentials
    ranges = time_constant_ranges(policy.circuit, potentials, policy.sensing.neurons)
    return {each.neuron: (each.lowest_s, each.highest_s) for each in ranges}


def drives(store: ResultStore) -> list[tuple[Policy, Rollout]]:
    """Return the successful parking circuits, the highest return first, each with its drive."""
    results = [result for result in store.results("parking", "circuit") if result.success]
    if not results:
        raise UsageError("no parking circuit is trained: rover-ncp paper run --task parking --agent circuit")
    results.sort(key=lambda result: -result.mean)
    untrained = build_agent(find_task("parking"), "circuit", 0)
    assert isinstance(untrained, Policy)
    policies = [untrained.with_parameters(result.parameters.array()) for result in results]
    return [(policy, rollout(policy, load_course("parking"))) for policy in policies]


def parking_time_constants(store: ResultStore) -> dict[str, Any]:
    """Return each neuron's time constants in s (Table S7): of the best circuit, of all, and the paper's."""
    ranges = [
        {
            each.neuron: (each.lowest_s, each.highest_s)
            for each in time_constant_ranges(policy.circuit, drive.potentials, policy.sensing.neurons)
        }
        for policy, drive in drives(store)
    ]
    rows = [
        {
            "neuron": neuron,
            "best": best,  #: least and largest of the best circuit, as in the next two
            "all": (min(r[neuron][0] for r in ranges), max(r[neuron][1] for r in ranges)),  #: of all circuits
            "published": PUBLISHED_TIME_CONSTANTS_S.get(neuron),  #: the paper's
        }
        for neuron, best in ranges[0].items()
    ]
    return {"runs": len(ranges), "time_constants_s": rows}


def parking_contributions(store: ResultStore) -> dict[str, Any]:
    """Return Definition 1 for the neuron that turns right: signs by neuron, of how many circuits."""
    runs = [contributions(policy.circuit.neurons, drive.potentials) for policy, drive in drives(store)]
    rows = []
    for pair, published in PUBLISHED_SIGNS.items():
        best = runs[0][pair]
        signs = Counter(found[pair].sign for found in runs)
        rows.append(
            {
                "source": pair[0],
                "destination": pair[1],
                "best": {"sign": best.sign, "positive": best.positive, "negative": best.negative},
                "circuits": dict(signs),  #: by sign: how many
                "published": published,  #: the paper's sign
                "agree": signs[published],  #: how many circuits have the paper's sign
            }
        )
    return {"runs": len(runs), "contributions": rows}


def time_constants_text(found: dict[str, Any]) -> str:
    """Return Table S7 as Markdown."""
    rows = [("neuron", "best circuit, s", f"all {found['runs']} circuits, s", "paper, s")]
    rows += [
        (row["neuron"], *(_range(row[column]) for column in ("best", "all", "published")))
        for row in found["time_constants_s"]
    ]
    return markdown(rows)


def contributions_text(found: dict[str, Any]) -> str:
    """Return Definition 1's signs as Markdown."""
    rows = [("neuron", "best circuit", f"all {found['runs']} circuits", "paper", "agree")]
    rows += [
        (
            f"{row['source']} to {row['destination']}",
            f"{row['best']['sign']} ({row['best']['positive']} : {row['best']['negative']})",
            ", ".join(f"{count} {sign}" for sign, count in sorted(row["circuits"].items())),
            str(row["published"]),
            str(row["agree"]),
        )
        for row in found["contributions"]
    ]
    return markdown(rows)


def _range(ends: tuple[float, float] | None) -> str:
    return "" if ends is None else f"{ends[0]:.3g} .. {ends[1]:.3g}"
