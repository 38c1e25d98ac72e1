"""Write the generated parts of docs/paper.md: ``make paper-docs``."""

import re
from pathlib import Path

from paper.report import short_report
from paper.store import ResultStore

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "paper" / "results"
PAGE = ROOT / "docs" / "paper.md"
BLOCK = re.compile(r"(<!-- (?P<command>[^>]*) -->\n)(?P<table>.*?)(<!-- end -->)", re.DOTALL)


def report():
    """Return the report of the stored runs."""
    return short_report(ResultStore(RESULTS))


TABLES = {"python -m paper report": report}
"""By the command that made it: each generated part of the page."""


def generated(page):
    """Return the page with its generated parts made anew."""
    return BLOCK.sub(lambda block: f"{block[1]}\n{TABLES[block['command']]()}\n\n{block[4]}", page)


if __name__ == "__main__":
    PAGE.write_text(generated(PAGE.read_text()))
