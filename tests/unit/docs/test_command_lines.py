"""The command line parses every ``rover-ncp`` line of the README and the pages; no command runs."""

import re
import shlex

import pytest
import typer
from kit.paths import ROOT
from typer.main import get_command

from rover_ncp.cli import _app

PAGES = [ROOT / "README.md", *sorted(p for p in (ROOT / "docs").rglob("*.md") if "reference" not in p.parts)]
LINE = re.compile(r"^ *(rover-ncp (?:.*\\\n)*.*)", re.MULTILINE)
INLINE = re.compile(r"`(rover-ncp [a-z][^`]*)`")
ENDS = {"|", ">", "2>", "&", "&&", ";"}
PLACEHOLDERS = {"S": "1", "N": "1", "NAME": "algorithm1"}
"""Words of the pages that stand for a number or a name."""
NO_COMMANDS = {"lease"}
"""`rover-ncp lease` is text that the bridge signs."""


def lines(pattern):
    """Return the different lines of all pages, each with the first page that has it."""
    found = {}
    for page in PAGES:
        for line in pattern.findall(page.read_text()):
            found.setdefault(line, pytest.param(line, id=f"{page.stem}: {line}"))
    return found.values()


def parse(line):
    words = shlex.split(line.replace("\\\n", " "), comments=True)
    end = next((place for place, word in enumerate(words) if word in ENDS), None)
    words = [PLACEHOLDERS.get(word, word) for word in words[1:end]]
    group = get_command(_app())
    name, *arguments = words
    command = group.get_command(None, name)
    assert command is not None, f"no command {name}"
    command.make_context(name, arguments)


@pytest.mark.parametrize("line", [p for p in lines(LINE) if p.values[0] != "rover-ncp --help"])
def test_line_of_a_page_is_parsed(line):
    parse(line)


@pytest.mark.parametrize("line", [p for p in lines(INLINE) if p.values[0].split()[1] not in NO_COMMANDS])
def test_command_in_a_sentence_has_only_real_options(line):
    try:
        parse(line)
    except typer.BadParameter as error:  # a sentence may leave arguments out
        assert type(error).__name__ == "MissingParameter"


@pytest.mark.parametrize(
    "line", ["rover-ncp deploi", "rover-ncp deploy --no-such-option", "rover-ncp deploy"]
)
def test_wrong_line_is_noticed(line):
    with pytest.raises((typer.BadParameter.__mro__[1], AssertionError)):
        parse(line)
