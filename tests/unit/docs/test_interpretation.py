"""The shipped circuit explained in the documentation is the shipped circuit."""

import re

import pytest
from kit.paths import ROOT

from sim.explain.explain import explain
from sim.explain.files import markdown

FOLDER = ROOT / "docs" / "interpretation"
AGAIN = (
    "the shipped policy has changed: rover-ncp explain parking --out docs/interpretation, keep *.md and *.svg"
)


@pytest.mark.long
def test_the_shipped_circuit_is_the_one_that_is_explained():
    assert (FOLDER / "explanation.md").read_text() == markdown(explain("parking")), AGAIN


def test_every_picture_of_the_page_is_there():
    shown = set(re.findall(r"\]\((\w+\.svg)\)", (FOLDER / "explanation.md").read_text()))
    assert shown == {path.name for path in FOLDER.glob("*.svg")}
