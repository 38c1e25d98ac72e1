"""Write the generated part of docs/paper.md: ``make paper-docs``."""

import re
from pathlib import Path

from sim.paper.claims import judge_claims, load_claims
from sim.paper.report import short_report
from sim.paper.results import ResultStore

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "paper.md"
BLOCK = re.compile(r"(<!-- rover-ncp paper report -->\n)(?P<report>.*?)(<!-- end -->)", re.DOTALL)


def report():
    """Return the report of the stored runs."""
    store, file = ResultStore(ROOT / "results"), load_claims()
    return short_report(store, file, judge_claims(store, file.claims))


if __name__ == "__main__":
    PAGE.write_text(BLOCK.sub(lambda block: f"{block[1]}\n{report()}\n\n{block[3]}", PAGE.read_text()))
