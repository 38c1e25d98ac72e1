"""What has come since the paper: gradients through the solver beside the search: circuit, CfC and LTC."""

from collections.abc import Iterator, Sequence
from statistics import median

import numpy as np

from sim.paper.agents import CLONED, UNCLONED
from sim.paper.claims import Claim, Finding
from sim.paper.comparison import steps_to_success
from sim.paper.results import Result, ResultStore
from sim.paper.selection import LIQUID_TASKS
from sim.paper.significance import LEVEL, mean_text, measure
from sim.paper.tasks import TASKS

_SOURCE = "since the paper"
_ENOUGH_RUNS = 4
"""With fewer of each, no permutation test finds anything."""


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
    for agent in UNCLONED[1:]:
        yield Claim(
            f"robust-{agent}",
            f"Parking on random robots and courses: the circuit is on par with {agent} or better",
            _SOURCE,
            Finding.NOT_TESTED,
            "0 trainings on random robots",
            f"rover-ncp eval {agent}.json --randomize full --trials 1000 --seed 31415",
            f"python -m sim.studies.compare {agent} --rollouts 104 makes the file (an LSTM: 1,112 core s)",
        )


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
