"""The fields of the JSON that commands print, and those of the page of JSON results."""

from functools import cache

from result_fields import RESULTS, result_fields

BY_NAME = {
    *("commits", "ended", "failures", "ranges", "circuits", "std", "inside", "measured", "pids", "returns"),
    *("sensors", "motors", "median", "passed", "dropped", "limited", "stops", "nis"),
}
"""Fields whose own keys are names: of reasons, neurons and the like."""


@cache
def described(*headings):
    """Return the paths of the fields below some headings of the page."""
    return {path for heading in headings for path in result_fields(heading)}


def undescribed(command, printed):
    """Return the paths of what a command printed that no heading of it has; none for an error."""
    known = described(*(heading for heading in RESULTS if heading.split()[0] == command))
    return set(paths(printed, known)) - known if known and "error" not in printed else set()


def assert_on_page(printed, *headings, unseen=()):
    """Assert that headings have all that was printed, and beside it only what begins with ``unseen``."""
    known = described(*headings)
    found = set(paths(printed, known))
    assert not found - known
    assert not {path for path in known - found if not path.startswith(tuple(unseen))}


def paths(value, known, inside=""):
    """Yield the paths of all fields, as the page has them: ``NAME`` stands for a name."""
    if isinstance(value, list):
        for item in value:
            yield from paths(item, known, inside)
    elif isinstance(value, dict):
        named = any(path.startswith(f"{inside}NAME.") for path in known)
        for key, inner in value.items():
            path = inside + ("NAME" if named else key)
            if not named:
                yield path
            if key not in BY_NAME or any(each.startswith(f"{path}.") for each in known):
                yield from paths(inner, known, f"{path}.")
