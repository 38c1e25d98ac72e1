"""Mutation testing: ``make mutate``, or this file with ``[MODULE ...] [--only TEXT] [--workers N]``.

Every mutant differs from a module of `TESTS` in one place: a comparison, an operator, a constant, a
condition, a keyword of a call, a statement. The module's tests run against each mutant in a process of its
own, forked from one that has everything loaded. ``tests/data/survivors.yaml`` names each mutant that no test
kills, with the reason why the program is the same. A mutant that is listed there and dies is an error too.
"""

import argparse
import ast
import copy
import gc
import os
import sys
import types
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import grimp
import pytest
import yaml

ROOT = Path(__file__).parents[2]
SURVIVORS = ROOT / "tests" / "data" / "survivors.yaml"
GATE = [
    *("bridge/test_gate.py", "bridge/test_gate_commands.py", "bridge/test_gate_contact.py"),
    *("bridge/test_gate_hazards.py", "bridge/test_gate_odometry.py"),
    *("bridge/test_gate_fence.py", "bridge/test_gate_anything.py"),
]
TESTS = {
    "bridge.gate.gate": GATE,
    "bridge.gate.motion": GATE,
    "bridge.gate.state": GATE,
    "rover_ncp.wire.protocol": ["core/test_protocol.py", "bridge/test_gate_fence.py"],
    "bridge.pioneer.session": [
        "bridge/test_session_details.py",
        "bridge/test_session.py",
    ],
    "deploy.drive.safety_monitor": ["deploy/test_safety_rules.py"],
}
"""Files of ``tests/unit`` that must fail on every mutant of a module."""
PACKAGES = ("rover_ncp", "bridge", "deploy", "sim", "kit")
TIMEOUT_S = 30
NO_BEHAVIOUR = {"description", "frozen"}
"""Keywords for a reader and for the type checker, which refuses changes of what is frozen."""

COMPARISONS = {
    ast.Lt: [ast.LtE, ast.GtE],
    ast.LtE: [ast.Lt, ast.Gt],
    ast.Gt: [ast.GtE, ast.LtE],
    ast.GtE: [ast.Gt, ast.Lt],
    ast.Eq: [ast.NotEq],
    ast.NotEq: [ast.Eq],
    ast.Is: [ast.IsNot],
    ast.IsNot: [ast.Is],
    ast.In: [ast.NotIn],
    ast.NotIn: [ast.In],
}
OPERATORS = {
    ast.Add: [ast.Sub],
    ast.Sub: [ast.Add],
    ast.Mult: [ast.Div],
    ast.Div: [ast.Mult],
    ast.FloorDiv: [ast.Div],
}


def mutations(node):  # noqa: PLR0912  # one branch for each kind of node
    """Yield (what, change) for one node; ``change`` alters a copy of it in place."""
    if isinstance(node, ast.Compare):
        for place, operator in enumerate(node.ops):
            for other in COMPARISONS.get(type(operator), []):
                yield f"{type(operator).__name__} to {other.__name__}", _set("ops", place, other())
    elif isinstance(node, ast.BinOp):
        for other in OPERATORS.get(type(node.op), []):
            yield f"{type(node.op).__name__} to {other.__name__}", _set("op", None, other())
    elif isinstance(node, ast.BoolOp):
        other = ast.Or if isinstance(node.op, ast.And) else ast.And
        yield f"{type(node.op).__name__} to {other.__name__}", _set("op", None, other())
        for place in range(len(node.values)):
            yield f"operand {place} gone", _remove_operand(place)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield f"{type(node.op).__name__} gone", None
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield f"{node.value} to {not node.value}", _set("value", None, not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield f"{node.value} to {node.value + 1}", _set("value", None, node.value + 1)
    elif isinstance(node, ast.Call):
        for place, keyword in enumerate(node.keywords):
            if keyword.arg is not None and keyword.arg not in NO_BEHAVIOUR:
                yield f"{keyword.arg}= gone", _remove("keywords", place)
        if isinstance(node.func, ast.Name) and node.func.id in {"min", "max"}:
            other = {"min": "max", "max": "min"}[node.func.id]
            yield f"{node.func.id} to {other}", _set("func", None, ast.Name(other, ast.Load()))
    elif isinstance(node, ast.If | ast.IfExp | ast.While):
        for value in (True, False):
            yield f"condition {value}", _set("test", None, ast.Constant(value))
    elif _acts(node):
        yield "statement gone", _pass


def _acts(node):
    """Whether a statement calls, raises or changes an object; without a local variable others would fail."""
    if isinstance(node, ast.Assign | ast.AugAssign):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        return all(isinstance(target, ast.Attribute) for target in targets)
    return isinstance(node, ast.Raise) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call))


def _pass(target):
    target.__class__ = ast.Pass


def _set(name, place, value):
    def change(target):
        if place is None:
            setattr(target, name, value)
        else:
            getattr(target, name)[place] = value

    return change


def _remove(name, place):
    return lambda target: getattr(target, name).pop(place)


def _remove_operand(place):
    def change(target):
        if len(target.values) > 2:
            target.values.pop(place)
        else:  # "x and x" is x; Python compiles no "and" of one operand
            target.values[place] = target.values[1 - place]

    return change


def mutants(module):
    """Yield (name, tree) of every mutant; a name is the function, the line's text and the change."""
    source = source_of(module).read_text()
    lines, tree = source.splitlines(), ast.parse(source)
    owners = {}
    for owner in [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef)]:
        for node in ast.walk(owner):
            owners[node] = owner.name
    counts = {}
    keywords = [node for node in ast.walk(tree) if isinstance(node, ast.keyword)]
    left_out = {keyword.value for keyword in keywords if keyword.arg in NO_BEHAVIOUR}
    for index, node in enumerate(ast.walk(tree)):
        if node in left_out:
            continue
        for what, change in mutations(node):
            mutant = copy.deepcopy(tree)
            target = list(ast.walk(mutant))[index]
            if change is None:
                target.op, target.operand = _without(target)
            else:
                change(target)
            text = lines[node.lineno - 1].strip()
            name = f"{owners.get(node, 'module')}: {text} [{what}]"
            counts[name] = counts.get(name, 0) + 1
            number = f" #{counts[name]}" if counts[name] > 1 else ""
            yield name + number, ast.fix_missing_locations(mutant)


def _without(node):
    """A unary operator that does nothing: plus for minus, a double not for not."""
    if isinstance(node.op, ast.USub):
        return ast.UAdd(), node.operand
    return ast.Not(), ast.UnaryOp(ast.Not(), node.operand)


def source_of(module):
    return ROOT.joinpath(*module.split(".")).with_suffix(".py")


def run_tests(module, *more):
    """Run a module's tests against the module in place; return whether one failed."""
    tests = [str(ROOT / "tests" / "unit" / name) for name in TESTS[module]]
    options = ["-x", "-q", "--tb=no", "-p", "no:cacheprovider", f"--timeout={TIMEOUT_S}"]
    options += ["--hypothesis-seed=0", "--hypothesis-profile=mutants"]
    options += ["-W", "ignore::pytest.PytestAssertRewriteWarning", "-W", "ignore::pytest.PytestConfigWarning"]
    return pytest.main([*options, *more, *tests]) != 0


def killed(module, tree, users):
    """Whether the tests notice the mutant, or one of them never ends."""
    file = str(source_of(module))
    code = compile(tree, file, "exec")  # outside the try: a mutant that is no program is not a killed one
    child = os.fork()
    if child == 0:
        for stream in (1, 2):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
        try:
            for name in list(sys.modules):
                if name in users or name.startswith("tests."):
                    del sys.modules[name]
            mutant = types.ModuleType(module)
            mutant.__file__ = file
            sys.modules[module] = mutant
            exec(code, mutant.__dict__)
            package, _, last = module.rpartition(".")
            setattr(sys.modules[package], last, mutant)
            failed = run_tests(module)
        except BaseException:
            failed = True
        os._exit(0 if failed else 1)
    _, status = os.waitpid(child, 0)
    return status != 256


def survivors_of(module, only, workers, users):
    """Run the mutants of a module whose names contain ``only``; return how many, and those that survive."""
    run_tests(module, "--collect-only", "-qq")  # what all of them load is loaded once
    if killed(module, ast.parse(source_of(module).read_text()), users):
        sys.exit(f"{module} itself does not pass its tests")
    chosen = [(name, tree) for name, tree in mutants(module) if only in name]
    gc.freeze()  # or each child's collector would walk through all those trees
    alive = []
    with ThreadPoolExecutor(workers) as pool:
        results = pool.map(lambda item: killed(module, item[1], users), chosen)
        for number, ((name, _), died) in enumerate(zip(chosen, results, strict=True), 1):
            outcome = "killed" if died else "SURVIVES"
            print(f"{module} {number}/{len(chosen)} {outcome}  {name}", file=sys.stderr, flush=True)
            if not died:
                alive.append(name)
    return {name for name, _ in chosen}, alive


def main(arguments):
    parser = argparse.ArgumentParser()
    parser.add_argument("modules", nargs="*", default=[*TESTS], metavar="MODULE", help=", ".join(TESTS))
    parser.add_argument("--only", default="", help="only mutants whose name contains this text")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    options = parser.parse_args(arguments)
    sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    listed = yaml.safe_load(SURVIVORS.read_text())
    failed = False
    for module in options.modules:
        known = {name for name in listed.get(module, {}) if options.only in name}
        names, alive = survivors_of(
            module, options.only, options.workers, graph.find_downstream_modules(module)
        )
        wrong = {
            "survives": [name for name in alive if name not in known],
            "listed, but dies": [name for name in known if name in names and name not in alive],
            "listed, no mutant": [name for name in known if name not in names],
        }
        print(f"{module}: {len(names)} mutants, {len(alive)} survive, {len(wrong['survives'])} unexplained")
        for title, found in wrong.items():
            for name in sorted(found):
                print(f"{title}: {name}")
        failed = failed or any(wrong.values())
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
