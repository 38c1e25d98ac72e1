"""Write what ``rover-ncp paper`` prints into docs/paper.md: ``make paper-docs``.

Studies that take a minute are stored in docs/data as their ``--json``; their tables are made of that.
"""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

from sim.paper.lesions import lesions_text

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "paper.md"
BLOCK = re.compile(
    r"(<!-- (?:printed: (?P<command>rover-ncp paper [^>]+?)|stored: (?P<study>\w+)) -->\n)"
    r"(?P<table>.*?)(<!-- end -->)",
    re.DOTALL,
)
STUDIES = {"lesions": lesions_text}


def stored(study):
    """Return the rows of a study."""
    return json.loads((DOCS / "data" / f"paper-{study}.json").read_text())[study]


def blocks(text, kind):
    """Return each command, or study, of the page with the table that stands below it."""
    return {match[kind]: match["table"].strip() for match in BLOCK.finditer(text) if match[kind]}


def printed(command):
    """Return what a command prints of the shipped runs."""
    arguments = [*shlex.split(command)[1:], "--runs", "/nonexistent"]
    code = "from rover_ncp.entry import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True, cwd=DOCS.parent
    )
    return done.stdout.strip()


def filled(match):
    """Return a block with its table."""
    study = match["study"]
    table = STUDIES[study](stored(study)) if study else printed(match["command"])
    return f"{match[1]}\n{table}\n\n{match[5]}"


if __name__ == "__main__":
    PAGE.write_text(BLOCK.sub(filled, PAGE.read_text()))
