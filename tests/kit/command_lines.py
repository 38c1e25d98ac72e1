"""Command lines of pages and files, parsed without running them."""

import shlex

from typer.core import TyperGroup
from typer.main import get_command

from rover_ncp.cli import _app

ENDS = {"|", ">", "2>", "&", "&&", ";"}
PLACEHOLDERS = {"S": "1", "N": "1", "NAME": "algorithm1"}
"""Words of the pages that stand for a number or a name."""
GROUP = get_command(_app())


def parse(line):
    """Parse the command line up to its end in a shell; raise for an unknown command or a wrong option."""
    words = shlex.split(line.replace("\\\n", " "), comments=True)
    end = next((place for place, word in enumerate(words) if word in ENDS), None)
    command, name, arguments = GROUP, "rover-ncp", [PLACEHOLDERS.get(word, word) for word in words[1:end]]
    while isinstance(command, TyperGroup):
        name, *arguments = arguments
        command = command.get_command(None, name)
        assert command is not None, f"no command {name}"
    command.make_context(name, arguments)
