"""The generated pages of the documentation, and its examples of YAML files."""

import re

import numpy as np
import pytest
import reference_pages
import yaml
from kit.paths import ROOT

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.config import parse_yaml
from rover_ncp.course.course import load_course
from sim.learn.rollout import rollout

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


def test_the_example_of_a_policy_drives_forward_until_it_sees_one_metre():
    run = rollout(load_policy(EXAMPLES / "policy.yaml"), load_course("parking"))
    assert 0.05 < run.poses[-1, 0] < 1.5
    assert run.commands[-1, 0] < 0.5 * run.commands[5, 0]
    assert np.ptp(run.poses[:, 1]) == 0.0
