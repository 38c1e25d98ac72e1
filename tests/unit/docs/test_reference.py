"""The generated pages of the documentation, and its examples of YAML files."""

import re

import pytest
import reference_pages
import yaml
from kit.paths import ROOT

from rover_ncp.core.config import parse_yaml

EXAMPLES = ROOT / "docs" / "examples"
# Examples that leave keys out: bodies of MuJoCo, what a robot is seldom measured for, a Pioneer's own.
OPTIONAL = {"randomization", "robot", "description", "rover", "limits"}


@pytest.mark.parametrize("name", reference_pages.MODELS)
def test_an_example_is_valid_and_has_every_key_that_its_file_needs(name):
    assert {path.stem for path in EXAMPLES.glob("*.yaml")} == set(reference_pages.MODELS)
    _, model = reference_pages.MODELS[name]
    text = (EXAMPLES / f"{name}.yaml").read_text()
    parse_yaml(text, model, name)
    if name not in OPTIONAL:
        commented = re.findall(r"^# (\w+)", text, re.MULTILINE)
        assert set(model.model_fields) == {*yaml.safe_load(text), *commented} & set(model.model_fields)
