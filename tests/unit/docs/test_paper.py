"""The page on the paper: its tables are those that the commands print, and each citation is a claim."""

import re
import shlex
from pathlib import Path

import paper_tables
import pytest
from sim.paper.lesions import lesion_study

from rover_ncp import cli
from sim.paper import FAITHFUL
from sim.paper.claims import all_claims
from sim.paper.results import ResultStore

PAGE = paper_tables.PAGE.read_text()
BLOCKS = paper_tables.blocks(PAGE, "command")
TABLES = {
    *("random-circuits", "policy-gradients", "networks", "networks --budget published", "comparisons"),
    *("comparisons --budget published", "claims", "parameters", "status"),
    *(f"status --budget {budget}" for budget in FAITHFUL),
}


@pytest.fixture(scope="module")
def names():
    return {claim.name for claim in all_claims(ResultStore(Path("nowhere")))}


@pytest.mark.parametrize("command", BLOCKS)
def test_the_page_has_the_table_that_the_command_prints(command, tmp_path, capsys):
    runs = [] if command.endswith("parameters") else ["--runs", str(tmp_path)]
    assert cli.run([*shlex.split(command)[1:], *runs]) == 0
    table = capsys.readouterr().out.strip()
    assert table.count("\n") > 5
    assert table == BLOCKS[command], "make paper-docs writes the present tables"


@pytest.mark.parametrize("study", paper_tables.STUDIES)
def test_the_page_has_the_table_of_a_stored_study(study):
    table = paper_tables.STUDIES[study](paper_tables.stored(study))
    assert paper_tables.blocks(PAGE, "study")[study] == table, "make paper-docs writes the present tables"


@pytest.mark.long
def test_the_stored_lesions_are_those_of_the_shipped_circuits():
    found = lesion_study(ResultStore(Path("nowhere")), ["parking"])
    rows = [row for row in paper_tables.stored("lesions") if row["task"] == "parking"]
    assert [(row["part"], row["succeed"]) for row in rows] == [(row["part"], row["succeed"]) for row in found]
    assert [row["mean"] for row in rows] == pytest.approx([row["mean"] for row in found], rel=1e-9)


def test_the_page_has_all_tables():
    assert {command.removeprefix("rover-ncp paper ") for command in BLOCKS} >= TABLES


def test_every_citation_is_a_claim(names):
    text = " ".join(paper_tables.BLOCK.sub("", PAGE).split())
    cited = re.findall(r"\(((?:`[\w-]+`(?:, )?)+)\)", text)
    found = {name for group in cited for name in re.findall(r"`([\w-]+)`", group)}
    assert found <= names, found - names
    assert len(found) > 10
