"""The fields of the JSON that commands print, read from the code that makes them."""

import ast
import importlib
import inspect
import textwrap
from collections.abc import Iterator
from itertools import chain, pairwise, takewhile
from pathlib import Path
from typing import Any

from pydantic import BaseModel

RESULTS = {
    "park": "sim.park.park:ParkResult",
    "train": "sim.learn.results:TrainResult",
    "train --randomize": "sim.learn.results:RobustResult",
    "train --task": "sim.learn.results:TaskResult",
    "eval": "sim.evaluate.results:DriveOnceResult",
    "eval --trials": "sim.evaluate.results:TrialsResult",
    "eval --trials --stack, besides": "sim.evaluate.results:StackResult",
    "eval --task, a benchmark of the paper": "sim.paper.score_file:BenchmarkResult",
    "eval --task, an environment": "sim.evaluate.results:EnvironmentResult",
    "bench deploy": "sim.benchmarks.deploy:BenchResult",
    "paper run": "sim.paper.command_results:MadeResult",
    "paper replay": "sim.paper.command_results:ReplayResult",
    "paper report": "sim.paper.command_results:ReportResult",
    "mock": "sim.pioneer.run:PioneerMockResult sim.pioneer.run:Ros2MockResult",
    "bridge": "bridge.app:BridgeResult",
    "export": "rover_ncp.export.export:Exported",
    "urdf": "bridge.ros2.urdf:UrdfResult",
    "deploy": "deploy.drive.result:DriveResult",
    "teleop": "deploy.teleop:TeleopResult",
    "identify": "deploy.identify.run:IdentifyResult",
    "course": "deploy.view.commands:course problems=rover_ncp.course.feasibility:Problem",
    "replay": "deploy.replay:Comparison",
    "check": "deploy.check:CheckResult",
    "keys": "bridge.zenoh.credentials:KeysResult",
    "recover": "rover_ncp.recording.recording:Recovery",
    "explain": "sim.explain.explain:Result run=rover_ncp.course.course:Verdict",
    "report": "deploy.view.page:Report",
    "watch": "deploy.view.server:run",
}
"""By command: the code of its fields as ``module:name``, of those of an object ``a`` as ``a=module:name``.

A place without a module is in the module of the place before it. A pydantic model describes its fields, and
those of the models within it. A function returns the object, or gives it to ``Output.result``. A comment that
begins with ``#:``, behind a key or above it, describes the key.
"""
COMMON = {
    "p50": "median",
    "p99": "99th percentile",
    "max": "largest",
    "parked": "whether the rover parked",
    "reason": "why it did not park, or empty",
    "failure": "the first condition that was missed, or empty",
    "error_m": "final position error",
    "error_rad": "final heading error",
    "seed": "of random numbers",
    "predicted": "ticks without fresh odometry",
    "missed": "ticks that did not run",
    "circuit": "its name",
    "course": "its name",
    "files": "the files that were written",
    "robot": "the bridge's Zenoh address",
    "task": "its name",
    "tick_rate_hz": "reached over the whole drive",
    "ticks": "steps of control, 0.1 s each unless said otherwise",
    # Of one command each.
    "address": "to open in a browser",
    "cause": "what makes it undrivable",
    "checkpoint": "counted from 1",
    "detail": "in words",
    "format": "version of the profile's format",
    "horizon_s": "how long the course lasts",
    "randomize": "the ranges of the rovers",
    "t": "time on the course in s",
    "worst_miss_rad": "largest difference of heading at a checkpoint",
}
"""Meanings of fields that are not described where they are made, by their last name or last two names."""
_ROOT = Path(__file__).parents[1]


def result_fields(command: str) -> dict[str, str]:
    """Return the fields of a command's JSON with their meanings."""
    found: dict[str, str] = {}
    module = ""
    for entry in RESULTS[command].split():
        prefix, _, place = entry.rpartition("=")
        module = place.partition(":")[0] or module
        if prefix and not prefix.endswith("NAME"):
            found.setdefault(prefix, "")
        for path, meaning in _Source(module, place.partition(":")[2]).fields():
            whole = f"{prefix}.{path}" if prefix else path
            if not whole.endswith("NAME"):
                found[whole] = found.get(whole) or meaning
    order = list(found)
    paths = sorted(found, key=lambda path: order.index(path.split(".")[0]))
    return {path: found[path] or _common(path) for path in paths}


def _common(path: str) -> str:
    """Return the meaning of the longest end of a path that has one; empty if none has."""
    names = path.split(".")
    ends = (".".join(names[first:]) for first in range(len(names)))
    return next((COMMON[end] for end in ends if end in COMMON), "")


def noted(node: Any) -> dict[str, str]:
    """Return the fields of a class, each with its ``description`` or the text below it."""
    found = {}
    for field, below in pairwise([*node.body, None]):
        if isinstance(field, ast.AnnAssign):
            words = [each.value for each in getattr(field.value, "keywords", []) if each.arg == "description"]
            words += [below.value] if isinstance(below, ast.Expr) else []
            found[ast.unparse(field.target)] = words[0].value if words else ""
    return found


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models in the type of a field."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in getattr(annotation, "__args__", ()):
        yield from models_in(part)


def model_fields(model: type[BaseModel]) -> Iterator[tuple[str, str]]:
    """Yield the paths of a model's fields with their descriptions."""
    texts = {}
    for base in model.__mro__[-3::-1]:  # behind object and BaseModel
        texts |= noted(ast.parse(textwrap.dedent(inspect.getsource(base))).body[0])
    for field_name, field in model.model_fields.items():
        if field.exclude:
            continue
        name = field.serialization_alias or field_name
        yield name, field.description or texts.get(field_name, "")
        for part in models_in(field.annotation):
            for path, meaning in model_fields(part):
                yield f"{name}.{path}", meaning


class _Source:
    """A class or a function, found in the file of its module."""

    def __init__(self, module: str, name: str) -> None:
        text = (_ROOT / f"{module.replace('.', '/')}.py").read_text()
        self._module = module
        self._lines, self._node = text.splitlines(), ast.parse(text)
        for part in name.split("."):
            named = (node for node in ast.walk(self._node) if getattr(node, "name", None) == part)
            self._node: Any = next(node for node in named if not isinstance(node, ast.alias))
        self._nodes = list(ast.walk(self._node))
        self._open: set[str] = set()

    def fields(self) -> Iterator[tuple[str, str]]:
        """Yield the paths of all fields with their meanings."""
        if isinstance(self._node, ast.ClassDef):
            model = getattr(importlib.import_module(self._module), self._node.name)
            if isinstance(model, type) and issubclass(model, BaseModel):
                yield from model_fields(model)
            else:
                yield from noted(self._node).items()
            return
        calls = [node for node in self._nodes if isinstance(node, ast.Call) and node.args]
        printed = [call.args[0] for call in calls if getattr(call.func, "attr", "") == "result"]
        for value in printed or [node.value for node in self._nodes if isinstance(node, ast.Return)]:
            yield from self._keys(value)

    def _keys(self, value: Any) -> Iterator[tuple[str, str]]:
        """Yield the keys of an expression that is an object, or a list of objects."""
        match value:
            case ast.Dict():
                for key, inner in zip(value.keys, value.values, strict=True):
                    yield from self._keys(inner) if key is None else self._key(key, inner)
            case ast.DictComp(generators=[ast.comprehension(iter=ast.Tuple(elts=names))]):
                for name in names:
                    yield from self._key(value.key, value.value, name.value)
            case ast.DictComp():
                yield from self._key(value.key, value.value)
            case ast.IfExp(body=first, orelse=second):
                yield from chain(self._keys(first), self._keys(second))
            case ast.BinOp() | ast.ListComp() | ast.List() | ast.Tuple():
                for part in ast.iter_child_nodes(value):
                    yield from self._keys(part)
            case ast.Name(id=name) if name not in self._open:
                self._open.add(name)
                yield from self._assigned(name)
                self._open.remove(name)

    def _key(self, key: Any, value: Any, name: str = "NAME", at: Any = None) -> Iterator[tuple[str, str]]:
        """Yield a key with what is inside it; ``name`` is that of a loop's variable."""
        parts = key.values if isinstance(key, ast.JoinedStr) else [key]
        path = "".join(part.value if isinstance(part, ast.Constant) else name for part in parts)
        yield path, self._meaning(at or key)
        for inner, meaning in self._keys(value):
            yield f"{path}.{inner}", meaning

    def _assigned(self, name: str) -> Iterator[tuple[str, str]]:
        """Yield the keys of a variable, from what is assigned to it or to its keys, or appended to it."""
        for node in self._nodes:
            if isinstance(node, ast.Call) and ast.unparse(node.func) == f"{name}.append":
                yield from self._keys(node.args[0])
            if not isinstance(node, ast.Assign | ast.AnnAssign | ast.AugAssign):
                continue
            for target in getattr(node, "targets", None) or [node.target]:
                match target:
                    case ast.Name(id=own) if own == name:
                        yield from self._keys(node.value)
                    case ast.Subscript(value=ast.Name(id=own), slice=key) if own == name:
                        yield from self._key(key, node.value, at=target)

    def _meaning(self, key: Any) -> str:
        """Return the comment behind a key that begins its line, or above it."""
        line = self._lines[key.lineno - 1]
        if line[: key.col_offset].strip():
            return ""
        _, _, text = line.partition("  #: ")
        before = map(str.strip, self._lines[key.lineno - 2 :: -1])
        above = [line.removeprefix("#: ") for line in takewhile(lambda line: line.startswith("#: "), before)]
        return text or " ".join(above[::-1])
