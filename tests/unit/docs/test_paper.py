"""The page on the paper: its generated part, its length and its citations."""

import re

import paper_tables

from sim.paper.claims import load_claims

PAGE = paper_tables.PAGE.read_text()


def test_page_has_the_present_tables():
    assert [block["command"] for block in paper_tables.BLOCK.finditer(PAGE)] == list(paper_tables.TABLES)
    assert paper_tables.generated(PAGE) == PAGE, "make paper-docs writes the present tables"


def test_page_is_short_and_its_answers_come_first():
    assert len(PAGE.splitlines()) <= 300
    assert len(PAGE.split()) <= 4000
    assert PAGE.index("| **10. ") < PAGE.index("\n## ")


def test_cited_claims_exist():
    names = {claim.name for claim in load_claims().claims}
    text = paper_tables.BLOCK.sub("", PAGE)
    assert set(re.findall(r"\(`([a-z0-9]+-[\w-]+)`\)", text)) <= names
