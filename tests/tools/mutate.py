"""Mutation testing of the gate: ``python tests/tools/mutate.py [FIRST LAST]``, or ``make mutate``.

Every mutant differs from a module of ``bridge/gate`` (`MODULES`) in one place: a comparison, an operator, a
constant, a condition, a keyword of a call, a statement. Each is run against the gate's tests in a process of
its own, forked from one that has everything loaded. A mutant that no test kills must stand in
``tests/data/survivors.yaml`` with the reason why it is the same gate; one that stands there and dies
is an error too.
"""

import ast
import copy
import gc
import os
import sys
import types
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import yaml

import bridge

ROOT = Path(__file__).parents[2]
MODULES = {name: ROOT / "bridge" / "gate" / f"{name}.py" for name in ("gate", "motion")}
SURVIVORS = ROOT / "tests" / "data" / "survivors.yaml"
TESTS = [f"test_gate{part}.py" for part in ("", "_fence", "_anything")]
TIMEOUT_S = 30

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
                yield f"{type(operator).__name__} to {other.__name__}", _set(node, "ops", place, other())
    elif isinstance(node, ast.BinOp):
        for other in OPERATORS.get(type(node.op), []):
            yield f"{type(node.op).__name__} to {other.__name__}", _set(node, "op", None, other())
    elif isinstance(node, ast.BoolOp):
        other = ast.Or if isinstance(node.op, ast.And) else ast.And
        yield f"{type(node.op).__name__} to {other.__name__}", _set(node, "op", None, other())
        for place in range(len(node.values)):
            yield f"operand {place} gone", _remove(node, "values", place)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield f"{type(node.op).__name__} gone", None
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield f"{node.value} to {not node.value}", _set(node, "value", None, not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield f"{node.value} to {node.value + 1}", _set(node, "value", None, node.value + 1)
    elif isinstance(node, ast.Call):
        for place, keyword in enumerate(node.keywords):
            if keyword.arg is not None:
                yield f"{keyword.arg}= gone", _remove(node, "keywords", place)
        if isinstance(node.func, ast.Name) and node.func.id in {"min", "max"}:
            other = {"min": "max", "max": "min"}[node.func.id]
            yield f"{node.func.id} to {other}", _set(node, "func", None, ast.Name(other, ast.Load()))
    elif isinstance(node, ast.If | ast.IfExp | ast.While):
        for value in (True, False):
            yield f"condition {value}", _set(node, "test", None, ast.Constant(value))


def _set(node, name, place, value):
    def change(target):
        if place is None:
            setattr(target, name, value)
        else:
            getattr(target, name)[place] = value

    return change


def _remove(node, name, place):
    return lambda target: getattr(target, name).pop(place)


def mutants():
    """Yield (name, module, tree) of every mutant; a name is the function, the line's text and the change."""
    for module, path in MODULES.items():
        for name, tree in mutants_of(path.read_text()):
            yield name, module, tree


def mutants_of(source):
    lines, tree = source.splitlines(), ast.parse(source)
    owners = {}
    for function in [node for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)]:
        for node in ast.walk(function):
            owners[node] = function.name
    counts = {}
    for index, node in enumerate(ast.walk(tree)):
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


def run_tests(*more):
    """Run the gate's tests against the module in place; return whether one failed."""
    tests = [str(ROOT / "tests" / "unit" / "bridge" / name) for name in TESTS]
    options = ["-x", "-q", "-m", "not browser", "--tb=no", "-p", "no:cacheprovider", f"--timeout={TIMEOUT_S}"]
    options += ["--hypothesis-seed=0", "--hypothesis-profile=mutants"]
    options += ["-W", "ignore::pytest.PytestAssertRewriteWarning", "-W", "ignore::pytest.PytestConfigWarning"]
    return pytest.main([*options, *more, *tests]) != 0


def forget():
    """Let the next import of the gate and of what uses it be a new one."""
    for name in list(sys.modules):
        if "gate" in name and name.startswith(
            (*(f"bridge.gate.{name}" for name in MODULES), "tests.unit.bridge.test_gate", "gate_bench")
        ):
            del sys.modules[name]


def killed(name, tree):
    """Whether the tests notice the mutant, or one of them never ends."""
    child = os.fork()
    if child == 0:
        for stream in (1, 2):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
        try:
            forget()
            module = types.ModuleType(f"bridge.gate.{name}")
            module.__file__ = str(MODULES[name])
            sys.modules[module.__name__] = module
            exec(compile(tree, module.__file__, "exec"), module.__dict__)
            setattr(bridge.gate, name, module)
            failed = run_tests()
        except BaseException:
            failed = True
        os._exit(0 if failed else 1)
    _, status = os.waitpid(child, 0)
    return status != 256


def main(arguments):
    run_tests("--collect-only", "-qq")  # what all of them load is loaded once
    for module, path in MODULES.items():
        if killed(module, ast.parse(path.read_text())):
            print("the gate itself does not pass its tests")
            return 1
    found = list(mutants())
    gc.freeze()  # or each child's collector would walk through all those trees
    first, last = (int(arguments[0]), int(arguments[1])) if arguments else (0, len(found))
    chosen = found[first:last]
    listed = yaml.safe_load(SURVIVORS.read_text()) if SURVIVORS.exists() else {}
    dead, names = [], {name for name, _, _ in chosen}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for (name, _, _), died in zip(chosen, pool.map(lambda item: killed(*item[1:]), chosen), strict=True):
            dead.append(died)
            print(
                f"{len(dead)}/{len(chosen)} {'killed' if died else 'SURVIVES'}  {name}",
                file=sys.stderr,
                flush=True,
            )
    alive = {name for (name, _, _), died in zip(chosen, dead, strict=True) if not died}
    unexplained = sorted(alive - set(listed))
    wrong = sorted(name for name in listed if name in names and name not in alive)
    gone = sorted(name for name in listed if name not in {name for name, _, _ in found})
    print(f"{len(chosen)} mutants, {sum(dead)} killed, {len(alive)} survive, {len(unexplained)} unexplained")
    for title, items in (("survives", unexplained), ("listed, but dies", wrong), ("listed, no mutant", gone)):
        for name in items:
            print(f"{title}: {name}")
    return 1 if unexplained or wrong or gone else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
