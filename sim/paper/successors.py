"""What has come since the paper: CfC and LTC on random robots and courses, beside the circuit."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rover_ncp.core.files import read_text
from sim.paper.agents import LIQUID
from sim.paper.claims import Claim, Finding
from sim.paper.significance import LEVEL, NO_GAP, fisher

_RANGES = {"harsh": "robots of `harsh`", "unseen": "robots of `full` on courses of no training"}
_TRIALS = 1000
_ROBUST = Path(__file__).parent / "random_robots"
"""What the study of random robots prints, an agent each."""


def successor_claims() -> Iterator[Claim]:
    """Yield how often each agent parks random robots, beside the circuit from the same search and trials."""
    circuit = _robust("circuit")
    for agent in LIQUID:
        found, tests = _robust(agent), []
        for ranges, words in _RANGES.items():
            hits, theirs = (round(each[ranges]["success_rate"] * _TRIALS) for each in (circuit, found))
            tests.append((words, hits, theirs, fisher(hits, _TRIALS, theirs, _TRIALS)))
        worse = any(test.p < LEVEL / len(tests) and test.difference < 0.0 for *_, test in tests)
        yield Claim(
            f"robust-{agent}",
            f"Parking on random robots and courses: the circuit is on par with {agent} or better",
            "since the paper",
            Finding.NOT_REPRODUCED if worse else Finding.DIFFERENCE,
            "; ".join(
                f"{words}: {hits} against {theirs} of {_TRIALS:,}, {test.sentence()}"
                for words, hits, theirs, test in tests
            ),
            f"rover-ncp eval benchmarks.compare:{agent} --randomize harsh --trials {_TRIALS} --seed 31415",
            f"one training of each; {LEVEL:g} by Bonferroni for {len(tests)} tests"
            + ("" if worse else f"; {NO_GAP}"),
        )


def _robust(agent: str) -> dict[str, Any]:
    """Return what the study of random robots printed for an agent."""
    found: dict[str, Any] = json.loads(read_text(_ROBUST / f"{agent}.json"))
    return found
