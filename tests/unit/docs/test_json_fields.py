"""The page of JSON results: it is made from the models that commands print."""

from importlib.metadata import entry_points

from result_fields import RESULTS

from rover_ncp import cli


def test_every_command_has_its_fields_on_the_page():
    commands = {heading.split()[0] for heading in RESULTS}
    assert commands == {point.name for point in entry_points(group=cli.GROUP)}
