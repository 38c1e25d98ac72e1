"""Options with a number or a choice reject other values, in one line that names it."""

import re

import pytest

from rover_ncp import cli

HUGE = 10**20
COMMANDS = ("bridge", "deploy", "identify")
"""Commands with a robot, and options of each kind."""


def _cases():
    """Yield a command, one of its options and a value that it must reject."""
    group = cli.get_command(cli._app())
    context = group.make_context("rover-ncp", [], resilient_parsing=True)
    for name in COMMANDS:
        for option in group.get_command(context, name).params:
            metavar = re.search(r"<(.+)>", (option.get_help_record(context) or [""])[0])
            kind = metavar[1] if metavar and option.opts[0].startswith("--") else ""
            if re.fullmatch(r"(int|float).*", kind):
                yield name, option.opts[0], "x"
                if option.min is not None:
                    yield name, option.opts[0], str(option.min - 1)
                if option.max is not None:
                    yield name, option.opts[0], str(HUGE)
            elif "|" in kind:
                yield name, option.opts[0], "no-such-choice"


CASES = list(_cases())


@pytest.mark.parametrize(("command", "option", "value"), CASES)
def test_a_wrong_value_is_one_line_and_exit_code_2(command, option, value, capfd):
    assert cli.run([command, f"{option}={value}"]) == 2
    printed = capfd.readouterr()
    assert printed.err.startswith("rover-ncp: ")
    assert printed.err.count("\n") == 1
    assert option in printed.err
    assert printed.out == ""
