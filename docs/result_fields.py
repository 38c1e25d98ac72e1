"""The fields of the JSON that commands print, read from the code that makes them."""

import ast
import importlib
import inspect
import textwrap
from collections.abc import Iterator
from dataclasses import is_dataclass
from itertools import pairwise
from typing import Any

from pydantic import BaseModel

RESULTS = {
    "park": "sim.park.park:ParkResult",
    "park without a trained agent": "sim.park.park:NotTrained",
    "park --dock": "sim.park.dock:DockedResult",
    "train": "sim.learn.results:TrainResult",
    "train --randomize": "sim.learn.results:RobustResult",
    "eval": "sim.evaluate.results:EvalResult",
    "mock": "sim.mock.run:MockResult",
    "bridge": "bridge.node:BridgeResult",
    "export": "rover_ncp.export.commands:Exported",
    "tag cameras": "deploy.tag.localiser:TagCameras",
    "tag print": "deploy.tag.localiser:TagPrintResult",
    "tag calibrate": "deploy.tag.localiser:TagCalibration",
    "tag run": "deploy.tag.localiser:TagRunResult",
    "deploy": "deploy.drive.result:DriveResult",
    "teleop": "deploy.teleop:TeleopResult",
    "identify": "deploy.identify.run:IdentifyResult",
    "course": "rover_ncp.course.feasibility:CourseResult",
    "place": "deploy.place.survey:PlaceResult",
    "replay": "deploy.replay:Comparison",
    "check": "deploy.check:CheckResult",
    "keys": "bridge.zenoh.certificate_authority:KeysResult",
    "recover": "rover_ncp.recording.recording:Recovery",
    "explain": "sim.explain.explain:Result",
    "report": "deploy.view.page:Report",
    "watch": "deploy.view.server:WatchResult",
}
"""By command: the model of its result as ``module:name``."""


def result_fields(command: str) -> dict[str, str]:
    """Return the fields of a command's JSON with their meanings."""
    module, _, name = RESULTS[command].partition(":")
    found: dict[str, str] = {}
    for path, meaning in model_fields(getattr(importlib.import_module(module), name)):
        found[path] = found.get(path) or meaning
    if unknown := [path for path, meaning in found.items() if not meaning]:
        raise ValueError(f"{RESULTS[command]}: fields without a description: {', '.join(unknown)}")
    return found


def noted(node: Any) -> dict[str, str]:
    """Return the fields of a class, each with its ``description`` or the text below it."""
    found = {}
    for field, below in pairwise([*node.body, None]):
        if isinstance(field, ast.AnnAssign):
            words = [each.value for each in getattr(field.value, "keywords", []) if each.arg == "description"]
            words += [below.value] if isinstance(below, ast.Expr) else []
            found[ast.unparse(field.target)] = words[0].value if words else ""
    return found


def models_in(annotation: Any) -> Iterator[Any]:
    """Yield the models and data classes in the type of a field."""
    if isinstance(annotation, type) and (issubclass(annotation, BaseModel) or is_dataclass(annotation)):
        yield annotation
    for part in getattr(annotation, "__args__", ()):
        yield from models_in(part)


def model_fields(model: Any) -> Iterator[tuple[str, str]]:
    """Yield the paths of a model's or a data class's fields with their descriptions."""
    if not issubclass(model, BaseModel):
        yield from noted(ast.parse(textwrap.dedent(inspect.getsource(model))).body[0]).items()
        return
    texts: dict[str, str] = {}
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
