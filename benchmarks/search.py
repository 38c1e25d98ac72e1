"""How far each search gets with the same budget.

    python -m benchmarks.search --seed 404 --csv returns.csv [--search gauss-newton]

trains with every strategy, or with one, from the same root seed. It prints one JSON object: returns after
some numbers of iterations, and how many agents pass -0.1 (they park), -0.05 and -0.03. With all 20,000
iterations that takes minutes.
"""

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from sim.learn.agents import AgentState, Snapshot, run_rounds
from sim.learn.record import TrainSettings, resolve_task
from sim.learn.search.strategies import SearchName
from sim.learn.train import training_plan
from sim.learn.workers import available_processes, local_workers

MARKS = (1000, 2000, 5000, 10_000, 20_000)
"""Iterations at which returns are looked at."""
PASSED = (-0.1, -0.05, -0.03)
"""Returns whose passing is counted."""


def bench_search(
    seed: int,
    agents: int,
    iterations: int,
    say: Callable[[str], None],
    strategies: Sequence[str] = tuple(SearchName),
) -> tuple[Mapping[str, Any], Mapping[str, Sequence[AgentState]]]:
    """Train with these strategies from one root seed; return what to report, and the agents by strategy."""
    marks = [mark for mark in MARKS if mark < iterations] + [iterations]
    trained = {}
    for strategy in strategies:
        settings = TrainSettings.model_validate(
            {"seed": seed, "agents": agents, "iterations": iterations, "search": strategy}
        )
        plan = training_plan(settings, resolve_task(settings))
        start = Snapshot(tuple(AgentState(number) for number in range(agents)))
        with local_workers(min(available_processes(), agents)) as workers:
            trained[strategy] = run_rounds(workers, plan, start, iterations, lambda _: False).agents
        say(_line(strategy, [agent.value for agent in trained[strategy]]))
    fields = {
        "seed": seed,  #: root seed
        "agents": agents,  #: how many
        "iterations": marks,  #: at which returns are looked at
        "strategies": {name: _summary(found, marks) for name, found in trained.items()},
    }
    return fields, trained


def _summary(agents: Sequence[AgentState], marks: Sequence[int]) -> dict[str, Any]:
    returns = {mark: [agent.value_at(mark) for agent in agents] for mark in marks}
    last = returns[marks[-1]]
    return {
        "returns": returns,  #: by iteration, then by agent
        "median": {mark: median(values) for mark, values in returns.items()},  #: by iteration
        #: by return: how many agents end past it
        "passed": {f"{level:g}": sum(value > level for value in last) for level in PASSED},
    }


def _line(strategy: str, returns: Sequence[float]) -> str:
    counts = ", ".join(f"{sum(value > level for value in returns)} past {level:g}" for level in PASSED)
    return f"{strategy}: median {median(returns):.4f}, worst {min(returns):.4f}; {counts} of {len(returns)}"


def returns_table(agents: Mapping[str, Sequence[AgentState]], seed: int, iterations: int) -> str:
    """Return all returns as CSV, a row for each agent; numbers read back to the same bits."""
    marks = [mark for mark in MARKS if mark < iterations] + [iterations]
    lines = [",".join(["strategy", "seed", "agent", *(f"after_{mark}" for mark in marks)])]
    for strategy, found in agents.items():
        for agent in found:
            values = (repr(agent.value_at(mark)) for mark in marks)
            lines.append(",".join([strategy, str(seed), str(agent.number), *values]))
    return "\n".join(lines) + "\n"


def main() -> None:
    """Compare from the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.search")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--agents", type=int, default=12)
    parser.add_argument("--iterations", type=int, default=20_000, help="of each agent")
    parser.add_argument("--search", choices=list(SearchName), help="this one alone")
    parser.add_argument("--csv", type=Path, help="write every agent's returns here")
    given = parser.parse_args()
    strategies = [given.search] if given.search else list(SearchName)
    found, trained = bench_search(
        given.seed, given.agents, given.iterations, lambda line: print(line, file=sys.stderr), strategies
    )
    if given.csv is not None:
        given.csv.write_text(returns_table(trained, given.seed, given.iterations))
    print(json.dumps(found, indent=2))


if __name__ == "__main__":
    main()
