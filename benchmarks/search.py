"""How far each search gets with the same budget.

    python -m benchmarks.search --seed 404 [--search gauss-newton] > returns.csv

trains with every strategy, or with one, from the same root seed. It prints a row for each agent, its best
return after some numbers of iterations, and says how many agents pass -0.1 (they park), -0.05 and -0.03. With
all 20,000 iterations that takes minutes.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from statistics import median

from sim.learn.agents import AgentState, Snapshot, run_rounds
from sim.learn.record import TrainSettings, resolve_task
from sim.learn.search.strategies import SearchName
from sim.learn.train import training_plan
from sim.learn.workers import available_processes, local_workers

MARKS = (1000, 2000, 5000, 10_000, 20_000)
"""Iterations at which returns are looked at."""
PASSED = (-0.1, -0.05, -0.03)
"""Returns whose passing is counted."""


def returns_table(
    seed: int, agents: int, iterations: int, say: Callable[[str], None], strategies: Sequence[str]
) -> Iterator[str]:
    """Train with these strategies from one root seed; yield lines of CSV, whose numbers read back exactly."""
    marks = [mark for mark in MARKS if mark < iterations] + [iterations]
    yield ",".join(["strategy", "seed", "agent", *(f"after_{mark}" for mark in marks)])
    for strategy in strategies:
        settings = TrainSettings.model_validate(
            {"seed": seed, "agents": agents, "iterations": iterations, "search": strategy}
        )
        plan = training_plan(settings, resolve_task(settings))
        start = Snapshot(tuple(AgentState(number) for number in range(agents)))
        with local_workers(min(available_processes(), agents)) as workers:
            trained = run_rounds(workers, plan, start, iterations, lambda _: False).agents
        say(_line(strategy, [agent.value for agent in trained]))
        for agent in trained:
            values = (repr(agent.value_at(mark)) for mark in marks)
            yield ",".join([strategy, str(seed), str(agent.number), *values])


def _line(strategy: str, returns: Sequence[float]) -> str:
    counts = ", ".join(f"{sum(value > level for value in returns)} past {level:g}" for level in PASSED)
    return f"{strategy}: median {median(returns):.4f}, worst {min(returns):.4f}; {counts} of {len(returns)}"


def main() -> None:
    """Compare from the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.search")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--agents", type=int, default=12)
    parser.add_argument("--iterations", type=int, default=20_000, help="of each agent")
    parser.add_argument("--search", choices=list(SearchName), help="this one alone")
    given = parser.parse_args()
    strategies = [given.search] if given.search else list(SearchName)
    for line in returns_table(
        given.seed, given.agents, given.iterations, lambda words: print(words, file=sys.stderr), strategies
    ):
        print(line, flush=True)


if __name__ == "__main__":
    main()
