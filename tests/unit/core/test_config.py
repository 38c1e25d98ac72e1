import os
import re
from collections.abc import Mapping
from typing import Annotated, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from rover_ncp.core.config import StrictModel, dump_yaml, parse_yaml
from rover_ncp.core.errors import ConfigError, FileError
from rover_ncp.core.files import write_atomic


class Wheel(StrictModel):
    radius_m: float = Field(gt=0)
    name: str


class Base(StrictModel):
    wheels: tuple[Wheel, ...] = ()
    speed: float = 0.5


class Numbers(StrictModel):
    speed: float = Field(default=1.0, gt=0)
    count: int = 1
    size: Annotated[float, Field(gt=0)] | tuple[float, float] = 1.0
    sides: tuple[float, ...] = ()
    by_name: Mapping[str, float] = Field(default_factory=dict)
    format: Literal[1] = 1
    pair: tuple[int, float] = (1, 1.0)


def refused(text, model, source="x.yaml"):
    """Return the error that a text gives."""
    with pytest.raises(ConfigError) as caught:
        parse_yaml(text, model, source)
    return caught.value


def test_every_problem_is_reported_at_once_with_its_path():
    error = refused(
        "wheels:\n- {radius_m: -1, name: left}\n- {radius_m: 0.1}\nspede: 3\nspeed: fast\n", Base, "base.yaml"
    )
    assert error.problems == (
        "$.wheels[0].radius_m: input should be greater than 0, got -1",
        "$.wheels[1].name: this key is missing",
        "$.speed: input should be a valid number, got 'fast'",
        "$.spede: unknown key",
    )
    assert str(error) == "base.yaml: " + "; ".join(error.problems)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("wheels: [", "not valid YAML at line 2"),
        ("- a\n- b\n", "expected a mapping"),
        ("wheels: !!python/object/apply:os.system ['true']\n", "not valid YAML"),
        ("speed: &a [*a]\n", "aliases included"),
    ],
)
def test_bad_yaml_is_one_line_naming_source_and_place(text, expected):
    error = str(refused(text, Base))
    assert expected in error
    assert error.startswith("x.yaml: ")
    assert "\n" not in error


@pytest.mark.parametrize(
    "value", ["yes", "null", '"1.5"', "[1]", "1:30", "010", "2001-01-01", ".nan", "1e999"]
)
def test_only_a_number_is_a_number(value):
    lines = [f"{key}: {value}" for key in ("speed", "count", "size", "format")]
    lines += [f"sides: [1, {value}]", f"by_name: {{a: {value}}}", f"pair: [{value}, 1]"]
    problems = refused("\n".join(lines), Numbers).problems
    paths = {re.match(r"\$\.\w+(\[\d\]|\.a)?", problem)[0] for problem in problems}
    assert paths >= {"$.count", "$.sides[1]", "$.by_name.a", "$.format", "$.pair[0]", "$.speed"}
    assert any(path.startswith("$.size") for path in paths)


@given(st.text(st.sampled_from("0123456789eE.:-+_xobn"), min_size=1))
def test_names_that_look_like_numbers_survive_yaml(name):
    assert parse_yaml(dump_yaml({"name": name, "radius_m": 1}), Wheel, "x").name == name


def nested(first, row):
    """Return 200 lines of YAML, each of which names the one before it."""
    lines = [f"a{n}: &a{n} {row.replace('*', f'*a{n - 1}')}" for n in range(1, 200)]
    return "\n".join([f"a0: &a0 {first}", *lines, "speed: *a199"])


@pytest.mark.timeout(20)
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (nested("[x, x]", "[*, *]"), "aliases"),
        ("sides: [" + "1," * 300_000 + "]", "more than 100000 values"),
        ("count: " + "9" * 400, "an integer of more than"),
        ("? " + "k" * 900_000 + "\n: 1", "unknown key"),
    ],
    ids=lambda text: text[:30].split("\n")[0],
)
def test_short_yaml_that_stands_for_much_is_a_short_error(text, expected):
    error = str(refused(text, Numbers))
    assert expected in error
    assert len(error) < 5000


def test_aliases_merge_keys_and_keys_that_look_like_numbers_are_read():
    text = "wheels: [&left {name: left, radius_m: 1}, {<<: *left, name: right}, *left]"
    assert [wheel.name for wheel in parse_yaml(text, Base, "x").wheels] == ["left", "right", "left"]
    assert parse_yaml("by_name: {1: 2, on: 3}", Numbers, "x").by_name == {"1": 2.0, "on": 3.0}


def test_failed_atomic_write_keeps_the_old_file_and_is_our_error(tmp_path, monkeypatch):
    path = tmp_path / "deep" / "file.txt"
    write_atomic(path, b"older")
    write_atomic(path, "old")

    def full_disk(handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(FileError, match="No space left"):
        write_atomic(path, "new")
    assert path.read_text() == "old"
    assert list(path.parent.iterdir()) == [path]
