"""YAML into validated models: all problems at once, each with the path of its value.

A configuration is a frozen pydantic model with SI units in its fields. Unknown keys are errors, so that a
typo is found; infinities and NaN are errors everywhere. Only a number is a number: ``yes``, ``1:30``, ``010``
and ``"1"`` are none, and ``1e3`` is one. ``"yes"`` and ``1`` are no bools. A key is text. Files of strangers
are read too, so their size is limited with each alias counted as all that it stands for.
"""

import math
import re
import reprlib
import unicodedata
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, ValidationError
from pydantic_core import CoreSchema

from rover_ncp.core.errors import ConfigError, FileError
from rover_ncp.core.files import read_text


class ResultModel(BaseModel):
    """Base of the results of commands: the text below a field describes it in the documentation."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True)


class StrictModel(BaseModel):
    """Base of all configuration models: frozen, finite, no unknown keys; no text is a number or a bool."""

    # A process loads many models and reads few of them: each is built when it is first used.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        schema: CoreSchema = _strict(handler(source))
        return schema


def _strict(schema: Any) -> Any:
    """Make all numbers and bools of a schema strict. pydantic's strict mode also refuses lists for tuples."""
    if isinstance(schema, dict):
        for key, part in schema.items():
            schema[key] = _strict(part)
        if schema.get("type") in {"bool", "int", "float"}:
            schema["strict"] = True
        elif schema.get("type") == "literal" and {type(value) for value in schema["expected"]} == {int}:
            return {"type": "chain", "steps": [{"type": "int", "strict": True}, schema]}
    elif isinstance(schema, list):
        return [_strict(part) for part in schema]
    return schema


MAX_NAME = 64
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+-]*$", max_length=MAX_NAME)]
"""Name of a circuit, a neuron or a robot, for files, messages and programs."""
_NO_NAME = re.compile(r"[^A-Za-z0-9_.+-]+")


def is_name(text: str) -> bool:
    """Return whether a text is a `Name`."""
    return 0 < len(text) <= MAX_NAME and text[0].isalnum() and not _NO_NAME.search(text)


def name_from(path: Path, other: str) -> str:
    """Return a `Name` made from the name of a file; ``other`` if nothing of it can be used."""
    plain = unicodedata.normalize("NFKD", path.stem).encode("ascii", "ignore").decode()
    return _NO_NAME.sub("-", plain).strip("-._+")[:MAX_NAME] or other


ModelT = TypeVar("ModelT", bound=BaseModel)


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]  # the C loader is optional
    """A safe loader whose keys are text; it rejects duplicate keys, which YAML would silently merge."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._flat = set[yaml.MappingNode]()

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Replace merge keys by what they merge, once: a merged mapping may be read before its own place."""
        if node in self._flat:
            return
        self._flat.add(node)
        seen = set()
        for key_node, _ in node.value:
            if isinstance(key_node, yaml.ScalarNode):
                if key_node.tag != _MERGE:
                    key_node.tag = _TEXT  # a file can choose numbers whose hashes are all the same
                if key_node.value in seen:
                    problem = f"key {_SHORT.repr(key_node.value)} appears twice"
                    raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
                seen.add(key_node.value)
        super().flatten_mapping(node)


_INT, _FLOAT, _TEXT, _MERGE = (f"tag:yaml.org,2002:{name}" for name in ("int", "float", "str", "merge"))
_NUMBERS = {
    _INT: re.compile(r"[-+]?(0|[1-9][0-9]*)$"),
    _FLOAT: re.compile(
        r"[-+]?(([0-9]+\.[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[0-9]+[eE][-+]?[0-9]+|\.(inf|nan))$",
        re.IGNORECASE,
    ),
}
"""Numbers of YAML 1.2 in decimals. YAML 1.1 also reads 1:30 as 90 and 010 as 8, and 1e3 as text."""
_NO_NUMBERS = {*_NUMBERS, "tag:yaml.org,2002:timestamp"}
_Loader.yaml_implicit_resolvers = {
    first: [(tag, regexp) for tag, regexp in resolvers if tag not in _NO_NUMBERS]
    for first, resolvers in _Loader.yaml_implicit_resolvers.items()
}
for _tag, _regexp in _NUMBERS.items():
    _Loader.add_implicit_resolver(_tag, _regexp, list("-+.0123456789"))


MAX_DIGITS = 19
"""Digits of an integer: more than any field, seed or time of ours has. Python's integers have no limit."""


def _integer(loader: Any, node: yaml.ScalarNode) -> int:
    text = loader.construct_scalar(node)
    if len(text.lstrip("+-")) > MAX_DIGITS:
        problem = f"an integer of more than {MAX_DIGITS} digits"
        raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
    return int(text)


_Loader.add_constructor(_INT, _integer)


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]  # the C dumper is optional
    """A safe dumper that writes short lists of numbers, and each row of a table, on one line."""


def _represent_list(dumper: Any, data: list[Any]) -> Any:
    flat = all(isinstance(item, int | float | str) for item in data)
    node = dumper.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=flat)
    for row in node.value:
        if isinstance(row, yaml.MappingNode):
            row.flow_style = True
    return node


def _represent_text(dumper: Any, data: str) -> Any:
    """Represent text; bytes of a file's name that are not UTF-8 have no other place in a text file."""
    text = data.encode(errors="surrogateescape").decode(errors="replace")
    return dumper.represent_scalar(_TEXT, text)


_Dumper.add_representer(str, _represent_text)
_Dumper.add_implicit_resolver(_FLOAT, _NUMBERS[_FLOAT], list("-+.0123456789"))  # quotes a name such as 1e3
_Dumper.add_representer(list, _represent_list)
_Dumper.add_representer(tuple, _represent_list)


_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = 100
_CUT = 200


MAX_CHARACTERS, MAX_VALUES, MAX_DEPTH = 1 << 20, 100_000, 100
"""Limits of a YAML file: characters, values (keys count too), and nesting of lists and mappings. libyaml's C
code ends the process on a nesting of 100,000. Our own files have 1,300 values and a nesting of 5."""


def read_yaml(text: str, source: str) -> Any:
    """Return the content of YAML text, not validated. Raises ConfigError naming ``source``."""
    if len(text) > MAX_CHARACTERS:
        raise ConfigError(source, [f"{len(text)} characters, expected {MAX_CHARACTERS} at most"])
    try:
        _require_small(text)
        return yaml.load(text, Loader=_Loader)  # _Loader is a SafeLoader
    except (yaml.YAMLError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise ConfigError(source, [f"not valid YAML{where}: {_cut(problem)}"]) from error


def _require_small(text: str) -> None:
    """Raise YAMLError for YAML beyond the limits or with tags, which turn short text into long values.

    An alias, a merged one too, counts as all that it stands for, which may be more than any memory holds.
    """
    total, sizes = 0.0, dict[str | None, tuple[float, float]]()  # values and nesting of each anchor
    started, nestings = list[tuple[str | None, float]](), [0.0]
    for event in yaml.parse(text, Loader=_Loader):
        nesting = 0.0
        if (tag := getattr(event, "tag", None)) is not None:
            raise _invalid(f"the tag {_SHORT.repr(tag)} is not supported", event)
        if isinstance(event, yaml.CollectionStartEvent):
            sizes[event.anchor] = math.inf, math.inf  # until it ends: what contains itself has no limit
            started.append((event.anchor, total))
            nestings.append(0.0)
            total += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = started.pop()
            nesting = nestings.pop() + 1
            sizes[anchor] = total - before, nesting
        elif isinstance(event, yaml.AliasEvent):
            values, nesting = sizes.get(event.anchor, (1.0, 0.0))  # the loader rejects an unknown one
            total += values
        elif isinstance(event, yaml.ScalarEvent):
            sizes[event.anchor] = 1.0, 0.0
            total += 1
        nestings[-1] = max(nestings[-1], nesting)
        if len(started) + nesting > MAX_DEPTH:
            raise _invalid(f"more than {MAX_DEPTH} lists or mappings in each other, aliases included", event)
        if total > MAX_VALUES:
            raise _invalid(f"more than {MAX_VALUES} values, aliases counted as what they stand for", event)


def _invalid(problem: str, event: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(None, None, problem, event.start_mark)


def _cut(text: str) -> str:
    """Return text of a file or a library, shortened for a message."""
    return text if len(text) <= _CUT else f"{text[: _CUT - 3]}..."


def parse_yaml(text: str, model: type[ModelT], source: str) -> ModelT:
    """Parse YAML text into ``model``; raises ConfigError naming ``source`` and the path of each bad value."""
    data = read_yaml(text, source)
    if not isinstance(data, dict):
        raise ConfigError(source, [f"expected a mapping of keys, got {type(data).__name__}"])
    return validated(data, model, source)


def validated(data: Any, model: type[ModelT], source: str) -> ModelT:
    """Return plain values as ``model``; raises ConfigError as `parse_yaml` does."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ConfigError(source, _lines(error.errors())) from error


def load_yaml(path: Path, model: type[ModelT]) -> ModelT:
    """Read a YAML file into ``model``. Raises FileError (unreadable) or ConfigError (wrong)."""
    return parse_yaml(read_filled(path), model, str(path))


def read_filled(path: Path) -> str:
    """Return the text of a file. Raises FileError if it cannot be read or is empty."""
    text = read_text(path)
    if not text.strip():
        raise FileError(f"{path}: the file is empty")
    return text


def dump_yaml(data: dict[str, Any]) -> str:
    """Return YAML whose numbers read back to the same bits, keys in the given order."""
    return str(yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=110))


def _lines(errors: Sequence[Any]) -> list[str]:
    """Return a line for each problem, with the path of its value."""
    # pydantic counts only the valid items of a tuple: with an invalid one, a length says nothing.
    inside = {item["loc"][:length] for item in errors for length in range(len(item["loc"]))}
    errors = [item for item in errors if item["type"] != "too_short" or item["loc"] not in inside]
    lines = []
    for item in errors:
        parts = (f"[{part}]" if isinstance(part, int) else f".{_cut(part)}" for part in item["loc"])
        lines.append(f"${''.join(parts)}: {_text(item)}")
    return lines


def _text(item: Any) -> str:
    message = item["msg"].removeprefix("Value error, ")
    message = message[0].lower() + message[1:]
    if item["type"] == "extra_forbidden":
        return "unknown key"
    if item["type"] == "missing":
        return "this key is missing"
    shown = _SHORT.repr(item["input"])
    return f"{message}, got {shown if len(shown) <= 60 else shown[:57] + '...'}"
