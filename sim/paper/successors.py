"""What has come since the paper: gradients through the solver beside the search: circuit, CfC and LTC."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from rover_ncp.core.files import read_text
from sim.paper.agents import CLONED, UNCLONED
from sim.paper.claims import Claim, Finding
from sim.paper.comparison import steps_to_success
from sim.paper.results import Result, ResultStore
from sim.paper.selection import LIQUID_TASKS
from sim.paper.significance import LEVEL, NO_GAP, fisher, mean_text, measure
from sim.paper.tasks import TASKS

_SOURCE = "since the paper"
_ENOUGH_RUNS = 4
"""With fewer of each, no permutation test finds anything."""
_RANGES = {"harsh": "robots of `harsh`", "unseen": "robots of `full` on courses of no training"}
_TRIALS = 1000
_ROBUST = Path(__file__).parent / "random_robots"
"""What the study of random robots prints, an agent each."""


def successor_claims(store: ResultStore) -> Iterator[Claim]:
    """Yield, for each agent and task, whether the gradient is faster than the search, and how both end."""
    for task in LIQUID_TASKS:
        for agent, cloned in zip(UNCLONED, CLONED, strict=True):
            runs = store.results(task, agent), store.results(task, cloned)
            claim = f"{TASKS[task].title}, {agent}: the gradient succeeds after fewer steps than the search"
            command = f"rover-ncp paper run --task {task} --agent {cloned}"
            name = f"gradient-{agent}-{task}"
            if min(map(len, runs)) < _ENOUGH_RUNS:
                figure = f"{len(runs[1])} runs by gradient and {len(runs[0])} by search came to their end"
                why = f"{_ENOUGH_RUNS} of each are needed, and the command makes those by gradient"
                yield Claim(name, claim, _SOURCE, Finding.NOT_TESTED, figure, command, why)
                continue
            figure, faster = _beside(*runs)
            starts = runs[0][0].settings["starts"]
            verdict, why = (Finding.REPRODUCED if faster else Finding.NOT_REPRODUCED), ""
            if faster and starts > 1:
                verdict = Finding.DIFFERENCE
                why = f"the search begins at the best of {starts:,} starts, the gradient at the first of them"
            yield Claim(name, claim, _SOURCE, verdict, figure, command, why)
    yield from _robust_claims()


def _robust_claims() -> Iterator[Claim]:
    """Yield how often each agent parks random robots, beside the circuit from the same search and trials."""
    others = {agent: _robust(agent) for agent in UNCLONED}
    circuit = others.pop(UNCLONED[0])
    for agent, found in others.items():
        tests = []
        for ranges, words in _RANGES.items():
            hits, theirs = (round(each[ranges]["success_rate"] * _TRIALS) for each in (circuit, found))
            tests.append((words, hits, theirs, fisher(hits, _TRIALS, theirs, _TRIALS)))
        worse = any(test.p < LEVEL / len(tests) and test.difference < 0.0 for *_, test in tests)
        yield Claim(
            f"robust-{agent}",
            f"Parking on random robots and courses: the circuit is on par with {agent} or better",
            _SOURCE,
            Finding.NOT_REPRODUCED if worse else Finding.DIFFERENCE,
            "; ".join(
                f"{words}: {hits} against {theirs} of {_TRIALS:,}, {test.sentence()}"
                for words, hits, theirs, test in tests
            ),
            f"rover-ncp eval sim/paper/random_robots/{agent}.json "
            f"--randomize harsh --trials {_TRIALS} --seed 31415",
            f"one training of each; {LEVEL:g} by Bonferroni for {len(tests)} tests"
            + ("" if worse else f"; {NO_GAP}"),
        )


def _robust(agent: str) -> dict[str, Any]:
    """Return what the study of random robots printed for an agent."""
    found: dict[str, Any] = json.loads(read_text(_ROBUST / f"{agent}.json"))
    return found


def _beside(searched: Sequence[Result], cloned: Sequence[Result]) -> tuple[str, bool]:
    """Return the figures of runs by search and by gradient, and whether the gradient is faster."""
    steps = [np.array([steps_to_success(run) for run in runs], np.float64) for runs in (cloned, searched)]
    ends = [np.array([run.mean for run in runs]) for runs in (cloned, searched)]
    speed, end = measure(*steps), measure(*ends)
    sizes = len(cloned), len(searched)
    alone, after = (median(run.settings[key] for run in cloned) for key in ("cloned", "cloned_steps"))
    means = " against ".join(mean_text(float(values.mean())) for values in ends)
    parts = (
        f"steps to success or the end {median(steps[0]):,.0f} against {median(steps[1]):,.0f} (medians), "
        f"{speed.sentence(*sizes)}",
        f"the clones alone reach {mean_text(alone)} after {after:,.0f} steps (medians)",
        f"{sum(run.success for run in cloned)} and {sum(run.success for run in searched)} runs succeed",
        f"ends: {means}, {end.sentence(*sizes)}",
    )
    # The steps of a run that failed are those to its end, which are fewer where its budget is smaller.
    succeeded = all(run.success for run in cloned)
    return "; ".join(parts), bool(succeeded and speed.p < LEVEL and speed.difference < 0.0)
