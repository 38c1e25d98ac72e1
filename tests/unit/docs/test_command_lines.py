"""The command line parses every ``rover-ncp`` line of README, pages and helps; no command runs."""

import re

import pytest
import typer
from kit.command_lines import GROUP, parse
from kit.paths import ROOT
from typer.core import TyperGroup

PAGES = [ROOT / "README.md", *sorted(p for p in (ROOT / "docs").rglob("*.md") if "reference" not in p.parts)]
LINE = re.compile(r"^ *(rover-ncp (?:.*\\\n)*.*)", re.MULTILINE)
INLINE = re.compile(r"`(rover-ncp [a-z][^`]*)`")
NO_COMMANDS = {"lease"}
"""`rover-ncp lease` is text that the bridge signs."""


def commands(group=GROUP, path="rover-ncp"):
    """Yield the path of each command and of its parts, and the command."""
    for name in group.list_commands(None):
        command = group.get_command(None, name)
        yield f"{path} {name}", command
        if isinstance(command, TyperGroup):
            yield from commands(command, f"{path} {name}")


COMMANDS = dict(commands())


def lines(pattern):
    """Return the different lines of all pages, each with the first page that has it."""
    found = {}
    for page in PAGES:
        for line in pattern.findall(page.read_text()):
            found.setdefault(line, pytest.param(line, id=f"{page.stem}: {line}"))
    return found.values()


@pytest.mark.parametrize("line", [p for p in lines(LINE) if p.values[0] != "rover-ncp --help"])
def test_line_of_a_page_is_parsed(line):
    parse(line)


@pytest.mark.parametrize("line", [p for p in lines(INLINE) if p.values[0].split()[1] not in NO_COMMANDS])
def test_command_in_a_sentence_has_only_real_options(line):
    try:
        parse(line)
    except typer.BadParameter as error:  # a sentence may leave arguments out
        assert type(error).__name__ == "MissingParameter"


@pytest.mark.parametrize("path", COMMANDS)
def test_help_of_a_command_has_an_example_and_its_lines_are_parsed(path):
    examples = LINE.findall(COMMANDS[path].help)
    assert any(f"{line} ".startswith(f"{path} ") for line in examples)
    for line in examples:
        parse(line)


def test_every_command_is_in_a_panel_of_the_help():
    assert {
        name for name in GROUP.list_commands(None) if GROUP.get_command(None, name).rich_help_panel is None
    } == set()


@pytest.mark.parametrize(
    "line", ["rover-ncp deploi", "rover-ncp deploy --no-such-option", "rover-ncp deploy"]
)
def test_wrong_line_is_noticed(line):
    with pytest.raises((typer.BadParameter.__mro__[1], AssertionError)):
        parse(line)
