"""Structure of the packages. The list of full folders is exact: one that has room again must leave it."""

import grimp
from kit.paths import ROOT

MAX_LINES = 400
MAX_MODULES = 16
PACKAGES = ("rover_ncp", "bridge", "deploy", "sim", "paper")
FOLDERS = (*PACKAGES, "benchmarks", "docs", "tests")

FULL_FOLDERS = {"tests/kit", "tests/process", "tests/unit/bridge"}


def cycles():
    """Return the modules of each import cycle, imports inside functions included."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    modules = graph.modules
    reached = {name: graph.find_downstream_modules(name) for name in modules}
    found = set()
    for name in modules:
        cycle = {other for other in reached[name] if name in reached.get(other, ())} | {name}
        if len(cycle) > 1:
            found.add(tuple(sorted(cycle)))
    return found


def modules():
    return [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]


def test_modules_import_each_other_in_no_cycle():
    assert cycles() == set()


def test_modules_are_short():
    lines = {str(path.relative_to(ROOT)): path.read_bytes().count(b"\n") for path in modules()}
    assert {name for name, count in lines.items() if count > MAX_LINES} == set()


def test_folders_hold_few_modules():
    parents = [str(path.parent.relative_to(ROOT)) for path in modules() if path.name != "__init__.py"]
    assert {name for name in parents if parents.count(name) > MAX_MODULES} == FULL_FOLDERS
