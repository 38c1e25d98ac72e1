"""Write what ``rover-ncp paper`` prints into docs/paper.md: ``make paper-docs``."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "paper.md"
BLOCK = re.compile(
    r"(<!-- printed: (?P<command>rover-ncp paper [^>]+?) -->\n)(?P<table>.*?)(<!-- end -->)", re.DOTALL
)


def blocks(text):
    """Return each command of the page with the table that stands below it."""
    return {match["command"]: match["table"].strip() for match in BLOCK.finditer(text)}


def printed(match):
    """Return a block with what its command prints of the shipped runs."""
    arguments = [*shlex.split(match["command"])[1:], "--runs", "/nonexistent"]
    code = "from rover_ncp.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        check=True,
        cwd=PAGE.parents[1],
    )
    return f"{match[1]}\n{done.stdout.strip()}\n\n{match[4]}"


if __name__ == "__main__":
    PAGE.write_text(BLOCK.sub(printed, PAGE.read_text()))
