"""Write the generated parts of docs/paper.md: ``make paper-docs``."""

import json
import re
from pathlib import Path

from sim.paper.claims import judge_claims, load_claims
from sim.paper.report import markdown, short_report
from sim.paper.results import ResultStore
from sim.paper.statistics import wilson

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "results"
PAGE = ROOT / "docs" / "paper.md"
BLOCK = re.compile(r"(<!-- (?P<command>[^>]*) -->\n)(?P<table>.*?)(<!-- end -->)", re.DOTALL)
SETS = {"harsh": "robots of `harsh`", "unseen": "robots of `full` on other courses"}
TRIALS = 1000


def report():
    """Return the report of the stored runs."""
    store, file = ResultStore(RESULTS), load_claims()
    return short_report(store, file, judge_claims(store, file.claims))


def random_robots():
    """Return how often each agent parks random robots, one training of each."""
    rows = [("agent", *SETS.values())]
    for agent in ("circuit", "cfc", "ltc"):
        stored = json.loads((RESULTS / "random-robots" / f"{agent}.json").read_text())
        hits = [round(stored[name]["success_rate"] * TRIALS) for name in SETS]
        cells = ["{} of {} ({:.1%} to {:.1%})".format(hit, TRIALS, *wilson(hit, TRIALS)) for hit in hits]
        rows.append((agent, *cells))
    return markdown(rows)


TABLES = {
    "rover-ncp paper report": report,
    "python -m benchmarks.compare AGENT --rollouts 104": random_robots,
}
"""By the command that made it: each generated part of the page."""


def generated(page):
    """Return the page with its generated parts made anew."""
    return BLOCK.sub(lambda block: f"{block[1]}\n{TABLES[block['command']]()}\n\n{block[4]}", page)


if __name__ == "__main__":
    PAGE.write_text(generated(PAGE.read_text()))
