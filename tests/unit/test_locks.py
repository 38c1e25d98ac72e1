"""The locked requirements: complete, of the versions of constraints.txt, and free of addresses."""

import re
import tomllib
from importlib.metadata import requires

import pytest
from kit.paths import ROOT
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

LOCKS = {path.stem: path.read_text() for path in (ROOT / "requirements").glob("*.txt")}
PIN = re.compile(r"^(?P<name>[a-z0-9-]+)==(?P<version>\S+)(?P<marker> ; [^\\]+)? \\$")
HASH = re.compile(r"^    --hash=sha256:[0-9a-f]{64}( \\)?$")
AGAIN = "make lock writes requirements/"


def constraints():
    lines = (ROOT / "constraints.txt").read_text().split()
    return {canonicalize_name(name): version for name, version in (line.split("==") for line in lines)}


def pins(extra):
    """Return the versions of a lock by name."""
    found = (PIN.match(line) for line in LOCKS[extra].splitlines())
    return {pin["name"]: pin["version"] for pin in found if pin}


def needed(requirement, extra=""):
    """Yield the requirement, and all that its installed distribution needs here."""
    parsed = Requirement(requirement)
    if parsed.marker and not parsed.marker.evaluate({"extra": extra}):
        return
    if parsed.name != "rover-ncp":
        yield parsed
    for part in parsed.extras or {""}:
        for other in requires(parsed.name) or ():
            yield from needed(other, part)


def test_base_and_every_extra_have_a_lock():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(LOCKS) == {"base", *project["optional-dependencies"]}, AGAIN


@pytest.mark.parametrize("extra", LOCKS)
def test_lock_is_a_list_of_pins_with_hashes(extra):
    for line, following in zip(LOCKS[extra].splitlines(), [*LOCKS[extra].splitlines()[1:], ""], strict=True):
        if PIN.match(line):
            assert HASH.match(following), line
        else:
            assert HASH.match(line), line
            assert line.endswith("\\") == bool(HASH.match(following)), line
    assert "torch" not in pins(extra)


@pytest.mark.parametrize("extra", LOCKS)
def test_versions_of_a_lock_are_those_of_the_constraints(extra):
    assert pins(extra).items() <= constraints().items(), AGAIN


@pytest.mark.parametrize("extra", LOCKS)
def test_lock_has_all_that_the_extra_needs_in_versions_that_it_allows(extra):
    pinned = pins(extra)
    for requirement in needed("rover-ncp" if extra == "base" else f"rover-ncp[{extra}]"):
        version = pinned.get(canonicalize_name(requirement.name))
        assert version, f"{requirement} is missing: {AGAIN}"
        assert requirement.specifier.contains(version), AGAIN
