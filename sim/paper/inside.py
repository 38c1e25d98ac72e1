"""Inside the trained parking circuits: time constants and contributions, beside the paper's."""

from collections import Counter
from typing import Any

from deploy.report.interpretation import contributions, time_constant_ranges
from deploy.report.published import CONTRIBUTIONS, TIME_CONSTANTS_S
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import UsageError
from rover_ncp.course.course import load_course
from sim.learn.rollout import rollout
from sim.paper.agents import build_agent
from sim.paper.cell import Cell, Shelf
from sim.paper.tasks import find_task


def _runs(shelf: Shelf) -> list[tuple[Cell, Policy]]:
    """Return the parking circuits of the runs that succeeded, the highest return first."""
    cells = [cell for cell in shelf.cells("parking", "circuit") if cell.success]
    if not cells:
        raise UsageError("no parking circuit is trained: rover-ncp paper run --task parking --agent circuit")
    cells.sort(key=lambda cell: -cell.mean)
    task = find_task("parking")
    trained = []
    for cell in cells:
        agent = build_agent(task, "circuit", cell.name.seed)
        assert isinstance(agent, Policy)
        trained.append((cell, agent.with_parameters(cell.vector)))
    return trained


def parking_time_constants(shelf: Shelf) -> dict[str, Any]:
    """Return each neuron's time constants in s (Table S7): of the best circuit, of all, and the paper's."""
    course = load_course("parking")
    ranges = [
        {
            each.neuron: (each.lowest_s, each.highest_s)
            for each in time_constant_ranges(
                policy.circuit, rollout(policy, course).potentials, policy.sensing.neurons
            )
        }
        for _, policy in _runs(shelf)
    ]
    rows = [
        {
            "neuron": neuron,
            "best": ranges[0][neuron],
            "all": (min(r[neuron][0] for r in ranges), max(r[neuron][1] for r in ranges)),
            "published": TIME_CONSTANTS_S.get(neuron),
        }
        for neuron in ranges[0]
    ]
    return {"runs": len(ranges), "time_constants_s": rows}


def parking_contributions(shelf: Shelf) -> dict[str, Any]:
    """Return Definition 1 for the neuron that turns right: signs by neuron, of how many circuits."""
    course = load_course("parking")
    signs: dict[str, Counter[str]] = {source: Counter() for source, _ in CONTRIBUTIONS}
    best: dict[str, dict[str, Any]] = {}
    runs = _runs(shelf)
    for number, (_, policy) in enumerate(runs):
        found = contributions(policy.circuit.neurons, rollout(policy, course).potentials)
        for source, target in CONTRIBUTIONS:
            one = found[source, target]
            signs[source][one.sign] += 1
            if number == 0:
                best[source] = {"sign": one.sign, "positive": one.positive, "negative": one.negative}
    rows = [
        {
            "source": source,
            "destination": target,
            "best": best[source],
            "circuits": dict(signs[source]),
            "published": sign,
            "agree": signs[source][sign],
        }
        for (source, target), sign in CONTRIBUTIONS.items()
    ]
    return {"runs": len(runs), "contributions": rows}
