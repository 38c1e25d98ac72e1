"""Pages that are made from the code, which ``make reference`` writes into ``build/reference``.

As a mkdocs hook, this module adds them to the site, with a front page made from README.md. It also replaces
a line that only links to a table of ``measured/`` by that table.
"""

import ast
import csv
import importlib
import inspect
import re
import textwrap
import typing
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from demo.build import demo_page
from pydantic import BaseModel, TypeAdapter
from typer.cli import get_docs_for_click

from bridge.gate.limits import Limits
from deploy.place.place import Place
from deploy.tag.tag_map import CameraFile, TagMap
from rover_ncp import cli
from rover_ncp.circuit import policy_file
from rover_ncp.course import signals
from rover_ncp.course.builder import PoseList
from rover_ncp.course.course import Course
from rover_ncp.robot.description import RobotDescription
from rover_ncp.robot.profile import RoverProfile
from rover_ncp.robot.robot_file import RobotSettings
from rover_ncp.wire import protocol
from rover_ncp.wire.key_table import KEYS, Kind, Role
from sim.world.randomization import Randomization

DOCS = Path(__file__).parent
BUILT = DOCS.parent / "build" / "reference"
TABLE = re.compile(r"^\[[^\]]+\]\((measured/\w+\.csv)\)$", re.MULTILINE)
"""A line that is a link to a table."""
COMMON = """
With `--json` a command prints exactly one JSON object on stdout ([JSON results](results.md)), and all
text for people goes to stderr. A mistake of the user is one line on stderr and an exit code. With
`--json` the object is then `{"error": ..., "kind": ..., "exit_code": ...}`.

**Parked** means that the rover is within 0.10 m and 0.10 rad of the last checkpoint at the course's
horizon, has moved less than 5 mm and 5 mrad in the last 2 s, and has touched nothing. A simulated drive
is judged by the true pose, a real one by the estimate.

No command replaces a file that exists without `--overwrite`; `keys` and recordings never do.
Results are written whole or not at all. A file that is read whole has at most 64 MiB, a YAML file
1,048,576 characters. A recording may unpack to 1 GiB, or to 100 times its size.

No output delays a command on which a rover depends (`bridge`, `mock`, `deploy`, `teleop`, `identify`,
`check`, `watch`, `tag run`, `up`). Text that its reader does not take is dropped beyond 1,000 lines, and the
number of dropped lines is reported.

No command imports Python files of the current folder, except the module of a policy `module:name`.
"""
"""What holds for all commands."""
MODELS: dict[str, tuple[str, type[BaseModel]]] = {
    "course": ("Course", Course),
    "poses": ("Poses for a course", PoseList),
    "place": ("Place", Place),
    "circuit": ("Circuit", policy_file._CircuitFile),
    "policy": ("Policy", policy_file._PolicyFile),
    "randomization": ("Randomization", Randomization),
    "robot": ("Robot file", RobotSettings),
    "description": ("Robot description", RobotDescription),
    "rover": ("Robot profile", RoverProfile),
    "limits": ("Limits of the gate", Limits),
    "tags": ("Tags", TagMap),
    "camera": ("Camera", CameraFile),
}
"""By the name of the example in ``examples/``."""
RESULTS = {
    "park": "sim.park.park:ParkResult",
    "park --dock": "sim.park.dock:DockedResult",
    "train": "sim.learn.ensemble:TrainResult",
    "train --randomize": "sim.learn.robust:RobustResult",
    "eval": "sim.evaluate.results:EvalResult",
    "eval --card": "sim.evaluate.card:Card",
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
    "setup": "bridge.setup.run:SetupResult",
    "up": "deploy.up.run:UpResult",
    "stop": "deploy.stop:StopResult",
}
"""By command: the model of its result as ``module:name``."""


def reference_pages() -> dict[str, str]:
    """Return the generated pages by their name in ``reference/``."""
    return {
        "commands.md": commands_page(),
        "lease.md": lease_page(),
        "files.md": files_page(),
        "keys.md": keys_page(),
        "results.md": results_page(),
    }


def on_files(files: Any, config: Any) -> Any:
    """Add the front page, the reference, the long tables on the paper and the demo to the site."""
    from mkdocs.structure.files import File

    from paper.report import long_report
    from paper.store import ResultStore

    text = front_page((DOCS.parent / "README.md").read_text())
    files.append(File.generated(config, "index.md", content=text))
    for name, page in reference_pages().items():
        files.append(File.generated(config, f"reference/{name}", content=page))
    store = ResultStore(DOCS.parent / "paper" / "results")
    content = f"# The paper: settings and runs\n\n{long_report(store)}\n"
    files.append(File.generated(config, "paper_tables.md", content=content))
    files.append(File.generated(config, "demo/index.html", content=demo_page()))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return a page with its tables of ``measured/``."""
    return TABLE.sub(lambda link: measured_table(DOCS / link[1]), markdown)


def measured_table(path: Path) -> str:
    """Return a CSV file as a Markdown table."""
    with path.open(newline="") as file:
        head, *rows = csv.reader(file)
    lines = (f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows))
    return "\n".join(lines)


def front_page(readme: str) -> str:
    """Return README.md with its links as they are from the site."""
    return readme.replace("](docs/", "](")


def commands_page() -> str:
    """Return the page of all commands with their arguments and options."""
    codes = [f"| {code} | {text} |" for code, text in cli.EXIT_CODES.items()]
    parts = [
        "# Commands",
        "`rover-ncp COMMAND --help` prints the same. `rover-ncp --version` prints the version, "
        "`--install-completion` completes commands and options in your shell.",
        "## All commands",
        "\n".join(["| exit code | meaning |", "|---|---|", *codes]),
        COMMON.strip(),
    ]
    group = cli.get_command(cli._app())
    context = group.make_context("rover-ncp", [], resilient_parsing=True)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        page = get_docs_for_click(obj=command, ctx=context, indent=1, name=name, call_prefix="rover-ncp")
        parts.append(page.replace("][", r"]\["))  # two brackets are a link in Markdown
    return "\n\n".join(parts) + "\n"


def files_page() -> str:
    """Return the page of all YAML files: an annotated example and the keys of each."""
    parts = [
        "# YAML files",
        "Unknown keys, infinities and NaN are errors. Units are SI unless a name has another.",
    ]
    for name, (title, model) in MODELS.items():
        example = (DOCS / "examples" / f"{name}.yaml").read_text()
        parts += [f"## {title}", f"```yaml\n{example}```"]
        comments = re.findall(r"^ *(?:- )?(\w+):.* # (.+)$", example, re.MULTILINE)
        said = {key: text for key, text in comments if len(re.findall(rf"\b{key}:", example)) == 1}
        parts += _tables(title, model, said)
        if name == "policy":
            parts.append(_signals())
    return "\n\n".join(parts) + "\n"


def _signals() -> str:
    """Return the section of the signals that a policy may name."""
    table = ["| signal | meaning |", "|---|---|"]
    table += [f"| `{signal.name}` | {_cell(signal.meaning)} |" for signal in signals.TABLE]
    return "\n\n".join(
        [
            "### Signals",
            "`sensing.inputs` of a policy that drives a rover name these signals:",
            "\n".join(table),
            "`motors.outputs` are `v` in m/s, forward, and `omega` in rad/s, to the left. "
            "[Python](../python.md#a-signal-of-your-own) says where a new signal goes. "
            "The inputs and outputs of a policy for a Gymnasium environment have names of your choice.",
        ]
    )


def _tables(title: str, model: type, said: Mapping[str, str] | None = None) -> Iterator[str]:
    """Yield the description and the keys of a model or a data class, and of those in its fields.

    ``said`` has meanings of a file's keys that the model does not describe. A result has no defaults.
    """
    seen = [model]
    for each in seen:
        schema = TypeAdapter(each).json_schema(mode="serialization")
        name = each.__name__.lstrip("_")
        if each is not model:
            yield f"### {title}: {name}"
        if each.__doc__ and each.__doc__ != BaseModel.__doc__ and not each.__name__.startswith("_"):
            yield inspect.cleandoc(each.__doc__)
        notes, required = _notes(each), schema.get("required", [])
        default = "" if said is None else " default |"
        rows = [f"| key | type |{default} meaning |", f"|---|---|{'---|' if default else ''}---|"]
        for key, field in schema.get("properties", {}).items():
            if default:
                default = f" {_default(field, key in required)} |"
            meaning = field.get("description") or notes.get(key) or (said or {}).get(key, "")
            rows.append(f"| `{key}` | {_type(field)} |{default} {_cell(meaning)} |")
        yield "\n".join(rows)
        types = typing.get_type_hints(each).values()
        seen += [part for hint in types for part in _models_in(hint) if part not in seen]


def _default(field: Mapping[str, Any], required: bool) -> str:
    found = field.get("default")
    if found is None:
        return "required" if required and "default" not in field else ""
    return "" if found in ("", []) or isinstance(found, dict) else f"`{found}`"


def _models_in(annotation: Any) -> Iterator[type]:
    """Yield the models and data classes in the type of a field."""
    if isinstance(annotation, type) and (issubclass(annotation, BaseModel) or is_dataclass(annotation)):
        yield annotation
    for part in typing.get_args(annotation):
        yield from _models_in(part)


def _type(schema: dict[str, Any]) -> str:
    """Return a JSON schema in words: type, choices, bounds."""
    if "$ref" in schema:
        return str(schema["$ref"]).rsplit("/", 1)[-1].lstrip("_")
    if "anyOf" in schema:
        return " or ".join(_type(part) for part in schema["anyOf"] if part.get("type") != "null")
    if "const" in schema:
        return f"`{schema['const']}`"
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    words = {"array": "list", "object": "mapping", "string": "text", "integer": "whole number"}
    text = words.get(schema.get("type", "any"), schema.get("type", "any"))
    if "prefixItems" in schema:
        return f"{len(schema['prefixItems'])} × {_type(schema['prefixItems'][0])}"
    if schema.get("type") == "array":
        text += f" of {_type(schema['items'])}"
    signs = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    bounds = [f"{sign} {schema[key]:g}" for key, sign in signs.items() if key in schema]
    return ", ".join([text, *bounds])


def _notes(model: type) -> dict[str, str]:
    """Return the text below each field in the source of a class and of its bases."""
    notes = {}
    for base in reversed(model.__mro__):
        if base.__module__.startswith(("rover_ncp", "bridge", "deploy", "sim")):
            body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0].body  # type: ignore[attr-defined]
            for field, below in pairwise(body):
                if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
                    notes[ast.unparse(field.target)] = below.value.value
    return notes


def keys_page() -> str:
    """Return the page of the Zenoh keys."""
    parts = [
        "# Zenoh keys",
        "Every key may have a namespace before it (`--namespace bot1`: `bot1/odom`). Messages are ROS 2 "
        "types in CDR; queries are JSON both ways. The rights are those of `rover-ncp keys`.",
    ]
    for kind, title in (
        (Kind.MESSAGE, "Messages"),
        (Kind.QUERYABLE, "Queries"),
        (Kind.TOKEN, "Liveliness tokens"),
    ):
        rows = ["| key | type | from | to | at most | content |", "|---|---|---|---|---|---|"]
        for row in KEYS:
            if row.kind is kind:
                latched = "; late subscribers get the last one" if row.latched else ""
                rows.append(
                    f"| `{row.name}` | {row.type} | {_roles(row.senders)} | {_roles(row.receivers)} "
                    f"| {row.max_bytes} B | {_cell(row.about)}{latched} |"
                )
        parts += [f"## {title}", "\n".join(rows)]
    return "\n\n".join(parts) + "\n"


def results_page() -> str:
    """Return the page of the JSON that commands print."""
    parts = [
        "# JSON results",
        "With `--json` a command prints one JSON object. Units are SI unless a name has another. A value "
        "that is not known or not finite is null. Exit codes: [Commands](commands.md).",
    ]
    for command, where in RESULTS.items():
        module, _, name = where.partition(":")
        model = getattr(importlib.import_module(module), name)
        parts += [f"## {command}", *_tables(command, model)]
    return "\n\n".join(parts) + "\n"


def lease_page() -> str:
    """Return the page of the lease protocol."""
    return f"# Lease protocol\n\n{inspect.cleandoc(protocol.__doc__ or '')}\n"


def _roles(roles: frozenset[Role]) -> str:
    return ", ".join(role.value for role in Role if role in roles)


def _cell(text: str) -> str:
    """Return text for a table's cell, in which only backticks mean what they do in Markdown."""
    parts = " ".join(text.split()).replace("``", "`").split("`")
    parts[::2] = [re.sub(r"([|\[*_])", r"\\\1", part) for part in parts[::2]]
    parts[::2] = [part.replace("<", "&lt;") for part in parts[::2]]
    return "`".join(parts)


if __name__ == "__main__":
    BUILT.mkdir(parents=True, exist_ok=True)
    for name, text in reference_pages().items():
        (BUILT / name).write_text(text)
        print(BUILT / name)
