"""The command line parses every ``rover-ncp`` line of README, pages and helps; no command runs."""

import re
import shlex

from kit.paths import ROOT
from typer.core import TyperGroup
from typer.main import get_command

from rover_ncp.cli import _app

PAGES = [ROOT / "README.md", *sorted(p for p in (ROOT / "docs").rglob("*.md") if "reference" not in p.parts)]
LINE = re.compile(r"^ *(rover-ncp (?:.*\\\n)*.*)", re.MULTILINE)
ENDS = {"|", ">", "2>", "&", "&&", ";"}
PLACEHOLDERS = {"S": "1", "N": "1", "NAME": "algorithm1"}
"""Words of the pages that stand for a number or a name."""
GROUP = get_command(_app())


def commands(group=GROUP, path="rover-ncp"):
    """Yield the path of each command and of its parts, and the command."""
    for name in group.list_commands(None):
        command = group.get_command(None, name)
        yield f"{path} {name}", command
        if isinstance(command, TyperGroup):
            yield from commands(command, f"{path} {name}")


def parse(line):
    """Parse the command line up to its end in a shell; raise for an unknown command or a wrong option."""
    words = shlex.split(line.replace("\\\n", " "), comments=True)
    end = next((place for place, word in enumerate(words) if word in ENDS), None)
    command, name, arguments = GROUP, "rover-ncp", [PLACEHOLDERS.get(word, word) for word in words[1:end]]
    while isinstance(command, TyperGroup) and arguments != ["--help"]:
        name, *arguments = arguments
        command = command.get_command(None, name)
        assert command is not None, f"no command {name}"
    if arguments != ["--help"]:
        command.make_context(name, arguments)


def test_every_line_of_pages_and_helps_is_a_command_that_parses():
    texts = [page.read_text() for page in PAGES]
    for path, command in commands():
        assert f"{path} " in f"{command.help} ", f"the help of {path} has no example"
        texts.append(command.help)
    failed = []
    for line in {line for text in texts for line in LINE.findall(text)}:
        try:
            parse(line)
        except Exception as error:
            failed.append((line, error))
    assert failed == []
