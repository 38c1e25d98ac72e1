"""The checklist of the paper's claims."""

import json
from pathlib import Path

import pytest

from rover_ncp.cli import run
from sim.paper import BudgetName
from sim.paper.claims import Finding, all_claims, claims_text, share_finding
from sim.paper.comparison import compare_agents
from sim.paper.results import ResultStore
from sim.paper.tables import TABLES, table


@pytest.fixture(scope="module")
def claims():
    return all_claims(ResultStore(Path("nowhere")))


def test_every_claim_has_a_verdict_a_figure_and_a_command(claims):
    assert len({claim.name for claim in claims}) == len(claims)
    for claim in claims:
        assert claim.verdict in set(Finding)
        assert claim.claim and claim.source and claim.figure
        assert claim.command.startswith("rover-ncp ")
        if claim.verdict is Finding.NOT_TESTED:
            assert claim.why, claim.name


def test_every_table_of_the_paper_and_every_supplement_table_is_in_the_list(claims):
    sources = " ".join(claim.source for claim in claims)
    for number in ("Table I", "Table II", "Table III", "Table IV", *(f"S{n}" for n in range(1, 8))):
        assert number in sources, number
    for which in TABLES:
        for row in table(which, ResultStore(Path("nowhere"))):
            assert row.published is None or any(
                claim.name == f"{which}-{row.task}-{row.agent}" for claim in claims
            )


def test_a_comparison_names_test_n_p_and_effect_size(claims):
    for row in compare_agents(ResultStore(Path("nowhere")), "random"):
        [claim] = [claim for claim in claims if claim.name == f"random-{row.task}"]
        for part in (
            "permutation test",
            f"n = {row.runs[0]} and {row.runs[1]}",
            "p = ",
            "difference",
            "Holm",
        ):
            assert part in claim.figure
        assert (claim.verdict is Finding.REPRODUCED) == (row.p_holm < 0.05 and row.means[0] > row.means[1])


def test_a_missing_gap_is_no_reproduction(claims):
    for claim in claims:
        if claim.name.startswith(("mlp-", "lstm-", "ppo-", "a2c-")) and claim.verdict is Finding.DIFFERENCE:
            assert "does not prove" in claim.why


def test_a_claim_of_all_runs_needs_all_of_them():
    assert [share_finding(hits, 4) for hits in (4, 3, 2, 0)] == [
        Finding.REPRODUCED,
        Finding.DIFFERENCE,
        Finding.NOT_REPRODUCED,
        Finding.NOT_REPRODUCED,
    ]


def test_the_command_prints_the_list(claims, tmp_path, capsys):
    assert run(["paper", "claims", "--json", "--runs", str(tmp_path)]) == 0
    found = json.loads(capsys.readouterr().out)["claims"]
    assert [row["name"] for row in found] == [claim.name for claim in claims]
    assert {"claim", "source", "verdict", "figure", "command"} <= set(found[0])
    assert claims_text(claims).count("\n") == len(claims) + 1
    assert BudgetName.PUBLISHED in claims_text(claims)
