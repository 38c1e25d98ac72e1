"""The page on the paper: its generated part, its length and its citations."""

import re

import paper_tables

from sim.paper.claims import load_claims
from sim.paper.tasks import TASKS

PAGE = paper_tables.PAGE.read_text()


def test_page_has_the_present_report():
    [block] = paper_tables.BLOCK.finditer(PAGE)
    assert block["report"].strip() == paper_tables.report(), "make paper-docs writes the present report"


def test_page_is_short_and_its_answers_come_first():
    assert len(PAGE.splitlines()) <= 300
    assert len(PAGE.split()) <= 4000
    assert PAGE.index("| 10. ") < PAGE.index("\n## ")


def test_cited_claims_exist():
    names = {claim.name for claim in load_claims().claims}
    text = paper_tables.BLOCK.sub("", PAGE)
    assert set(re.findall(r"\(`([a-z0-9]+-[\w-]+)`\)", text)) <= names


def test_margins_of_the_page_are_those_of_the_tasks():
    rows = dict(re.findall(r"^\| ([a-z -]+) \| .* \| ([\d.]+) \|$", PAGE, re.MULTILINE))
    for task in ("pendulum", "mountain car", "cart-pole", "half-cheetah", "parking"):
        assert float(rows[task]) == TASKS[task.replace(" ", "-")].margin
