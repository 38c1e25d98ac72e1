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
    "deploy": "deploy.app:_result deploy.drive.control_loop:Drive.measurements_used deploy.app:run "
    "deploy.recorder:Recorder.fields",
    "teleop": "deploy.teleop:run deploy.recorder:Recorder.fields",
    "identify": "rover_ncp.robot.profile:RoverProfile deploy.identify.run:_write_profile",
    "course": "deploy.view.commands:course problems=rover_ncp.course.feasibility:Problem",
    "replay": "deploy.commands:replay difference=deploy.replay:Difference",
    "check": "deploy.commands:check findings=deploy.check:Finding",
    "keys": "bridge.zenoh.credentials:KeysResult",
    "recover": "rover_ncp.recording.recording:Recovery",
    "explain": "sim.explain.explain:Explanation.fields run=rover_ncp.course.course:Verdict "
    "knock_outs=sim.explain.what_if:Knockout sensitivities=:Sensitivity sim.explain.commands:explain",
    "explain of a run": "deploy.view.findings:Findings.fields phases=:_phase "
    "phases.motor=deploy.view.phases:Mean phases.rival=:Mean phases.behind=:Mean phases.pulls=:Mean "
    "phases.change=:Change contributions=deploy.view.interpretation:Contribution "
    "time_constants=:TimeConstant",
    "report": "deploy.view.commands:report",
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
    "overruns": "predicted and missed ticks",
    "source": "the neuron that acts",
    "destination": "the neuron that it acts on",
    "sign": "of the contribution, by Definition 1 of the paper",
    "change_down": "change of the return after the step down",
    "circuit": "its name",
    "course": "its name",
    "down": "size of the step down; 0 at a bound",
    "driving.negative": "Q, without the rest",
    "driving.positive": "P, without the rest",
    "exit_code": "of the command",
    "files": "the files that were written",
    "kind": "of parameter, or of part",
    "knock_outs": "drives or episodes without a neuron or a synapse",
    "findings.name": "of the check",
    "knock_outs.name": "of the neuron or synapse",
    "sensitivities.name": "of the neuron or synapse",
    "neuron": "its name",
    "pose.refused": "outliers and values that are not finite",
    "robot": "the bridge's Zenoh address",
    "sensitivities": "of the return to each parameter",
    "sensitivities.slope": "change of the return per unit",
    "sensitivities.unit": "of the value and its steps",
    "sensitivities.value": "the parameter's",
    "taken": "received and decoded",
    "task": "its name",
    "tick_rate_hz": "reached over the whole drive",
    "ticks": "steps of control, 0.1 s each unless said otherwise",
    "unreadable": "that could not be decoded",
    # Of one command each.
    "address": "to open in a browser",
    "behind.mean_mV": "its potential",
    "before_mV": "the pull in the phase before",
    "cause": "what makes it undrivable",
    "checkpoint": "counted from 1",
    "detail": "in words",
    "difference.tick": "null if it belongs to none",
    "findings": "the result of each check",
    "findings.ok": "whether it passed",
    "format": "version of the profile's format",
    "highest_s": "its largest time constant in the run",
    "horizon_s": "how long the course lasts",
    "lowest_s": "its smallest time constant in the run",
    "motor.mean_mV": "its potential",
    "now_mV": "the pull in this phase",
    "out": "the file",
    "paper_s": "the paper's range",
    "pulls.mean_mV": "its pull on the neuron behind",
    "quantity": "what differs",
    "randomize": "the ranges of the rovers",
    "ready": "whether all checks passed",
    "recomputed": "the value now",
    "recorded": "the value in the recording",
    "rival": "motor neuron that acts against the output, or null",
    "rival.mean_mV": "its potential",
    "t": "time on the course in s",
    "turned_rad": "to the left",
    "worst_miss_rad": "largest difference of heading at a checkpoint",
    "start_s": "time at its beginning",
    "end_s": "time at its end",
    "label": "what the rover does",
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
    for attribute, field in model.model_fields.items():
        name = field.serialization_alias or attribute
        yield name, field.description or texts.get(name, "")
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
