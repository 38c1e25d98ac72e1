"""Pages that are made from the code, which ``make reference`` writes into ``reference/``.

As a mkdocs hook, this module makes the site's front page from README.md.
"""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from model_cards import models_page
from pydantic import BaseModel
from result_fields import RESULTS, models_in, noted, result_fields

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
from rover_ncp.wire.key_table import KEYS, Kind, Role
from sim.world.randomization import Randomization

DOCS = Path(__file__).parent
MODELS: dict[str, tuple[str, type[BaseModel]]] = {
    "course": ("Course", Course),
    "poses": ("Poses for a course", PoseList),
    "place": ("Place", Place),
    "circuit": ("Circuit", policy_file._CircuitFile),
    "policy": ("Policy", policy_file._PolicyFile),
    "randomization": ("Randomization", Randomization),
    "robot": ("Robot description", RobotDescription),
    "rover": ("Robot profile", RoverProfile),
    "limits": ("Limits of the gate", Limits),
    "tags": ("Tags", TagMap),
    "camera": ("Camera", CameraFile),
}
"""By the name of the example in ``examples/``."""
UNITS = {"rad_m": "rad/m", "rad_s": "rad/s", "per_s": "1/s", "us": "µs", "hz": "Hz", "mb": "MB"}
UNITS |= {unit: unit for unit in ("m", "rad", "s", "ms", "ns", "mV")}
"""By the end of a field's name."""


def reference_pages() -> dict[str, str]:
    """Return the generated pages by their name in ``reference/``."""
    return {
        "commands.md": commands_page(),
        "files.md": files_page(),
        "keys.md": keys_page(),
        "results.md": results_page(),
        "models.md": models_page(),
    }


def on_files(files: Any, config: Any) -> Any:
    """Add the front page, and the long tables on the paper, to the site."""
    from mkdocs.structure.files import File

    from sim.paper.claims import judge_claims, load_claims
    from sim.paper.report import long_report
    from sim.paper.results import ResultStore

    text = front_page((DOCS.parent / "README.md").read_text())
    files.append(File.generated(config, "index.md", content=text))
    store = ResultStore(DOCS.parent / "results")
    tables = long_report(store, judge_claims(store, load_claims().claims))
    files.append(File.generated(config, "paper_tables.md", content=f"# All claims and runs\n\n{tables}\n"))
    return files


def front_page(readme: str) -> str:
    """Return README.md with its links as they are from the site."""
    return readme.replace("](docs/", "](")


def commands_page() -> str:
    """Return the page of all commands with their arguments and options."""
    parts = [
        "# Commands",
        "`rover-ncp --version` prints the version. Exit codes and files: [Command line](../cli.md). What "
        "`--json` prints: [JSON results](results.md).",
    ]
    group = cli.get_command(cli._app())
    context = group.make_context("rover-ncp", [], resilient_parsing=True)
    for name in group.list_commands(context):
        parts += _command(group.get_command(context, name), f"rover-ncp {name}", 2)
    return "\n\n".join(parts) + "\n"


def _command(command: Any, path: str, level: int) -> Iterator[str]:
    yield f"{'#' * level} {path.removeprefix('rover-ncp ')}"
    yield inspect.cleandoc(command.help or "")
    context = command.make_context(path, [], resilient_parsing=True)
    records = [parameter.get_help_record(context) for parameter in command.params]
    rows = [f"| `{names}` | {_cell(text)} |" for names, text in filter(None, records)]
    if rows:
        yield "\n".join(["| argument or option | meaning |", "|---|---|", *rows])
    for name, part in getattr(command, "commands", {}).items():
        yield from _command(part, f"{path} {name}", level + 1)


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
        seen: list[type[BaseModel]] = [model]
        for each in seen:
            if each is not model:
                parts.append(f"### {title}: {each.__name__.lstrip('_')}")
            if each.__doc__ and each.__doc__ != BaseModel.__doc__ and not each.__name__.startswith("_"):
                parts.append(inspect.cleandoc(each.__doc__))
            parts.append(_keys(each, said))
            parts_of = [part for field in each.model_fields.values() for part in models_in(field.annotation)]
            seen += [part for part in dict.fromkeys(parts_of) if part not in seen]
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


def _keys(model: type[BaseModel], said: Mapping[str, str]) -> str:
    """Return the table of a model's keys; ``said`` are the comments of the example, by key."""
    notes, required = _notes(model), model.model_json_schema().get("required", [])
    rows = ["| key | type | default | meaning |", "|---|---|---|---|"]
    for name, field in model.model_fields.items():
        schema = _schema(model, name)
        default = "required" if name in required else f"`{field.get_default(call_default_factory=True)}`"
        if default in {"`None`", "`()`", "`{}`", "``"} or isinstance(field.default, BaseModel):
            default = ""
        meaning = field.description or notes.get(name) or said.get(name, "")
        rows.append(f"| `{name}` | {_type(schema)} | {default} | {_cell(meaning)} |")
    return "\n".join(rows)


def _schema(model: type[BaseModel], name: str) -> dict[str, Any]:
    schema: dict[str, Any] = model.model_json_schema()["properties"][name]
    return schema


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


def _notes(model: type[BaseModel]) -> dict[str, str]:
    """Return the text below each field in the source of a model, those of its bases included."""
    notes: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if not issubclass(base, BaseModel) or not base.__module__.startswith(("rover_ncp", "bridge", "sim")):
            continue
        notes |= noted(ast.parse(textwrap.dedent(inspect.getsource(base))).body[0])
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
        "With `--json` a command prints one JSON object. A dot leads into an object, or into the objects of "
        "a list; `NAME` stands for any name. A value that is not known or not finite is null. Files and exit "
        "codes: [Command line](../cli.md).",
    ]
    for command in RESULTS:
        rows = ["| field | unit | meaning |", "|---|---|---|"]
        for path, meaning in result_fields(command).items():
            names = path.split(".")[::-1]
            units = (unit for name in names for end, unit in UNITS.items() if name.endswith(f"_{end}"))
            rows.append(f"| `{path}` | {next(units, '')} | {_cell(meaning)} |")
        parts += [f"## {command}", "\n".join(rows)]
    return "\n\n".join(parts) + "\n"


def _roles(roles: frozenset[Role]) -> str:
    return ", ".join(role.value for role in Role if role in roles)


def _cell(text: str) -> str:
    """Return text for a table's cell, in which only backticks mean what they do in Markdown."""
    parts = " ".join(text.split()).replace("``", "`").split("`")
    parts[::2] = [re.sub(r"([|\[*_])", r"\\\1", part) for part in parts[::2]]
    parts[::2] = [part.replace("<", "&lt;") for part in parts[::2]]
    return "`".join(parts)


if __name__ == "__main__":
    for name, text in reference_pages().items():
        (DOCS / "reference" / name).write_text(text)
