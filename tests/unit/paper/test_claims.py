"""The checklist of the paper's claims."""

import json
import re
import shlex
from pathlib import Path

import pytest

from rover_ncp.cli import run
from sim.paper import BudgetName, successors
from sim.paper.claims import Finding, _estimate_claims, all_claims, claims_text, share_finding
from sim.paper.comparison import compare_agents
from sim.paper.results import ResultStore
from sim.paper.selection import select
from sim.paper.tables import TABLES, table
from sim.paper.value_claims import two_values

STORE = ResultStore(Path("nowhere"))


@pytest.fixture(scope="module")
def claims():
    return all_claims(STORE)


def test_every_claim_has_a_verdict_a_figure_and_a_command(claims):
    assert len({claim.name for claim in claims}) == len(claims)
    for claim in claims:
        assert claim.verdict in set(Finding)
        assert claim.claim and claim.source and claim.figure
        assert claim.command.startswith(("rover-ncp ", "python -m benchmarks."))
        if claim.verdict is Finding.NOT_TESTED:
            assert claim.why, claim.name
            assert claim.figure[0].isdigit(), claim.name  # how many runs, drives or videos there are


def test_a_command_that_makes_runs_has_some_to_make(claims):
    arguments = [shlex.split(claim.command)[3:] for claim in claims if " paper run " in claim.command]
    assert arguments
    for each in arguments:
        options = dict(zip(each[::2], each[1::2], strict=True))
        assert select([options["--task"]], None, None, None, [BudgetName(options.get("--budget", "default"))])


def test_few_runs_are_no_verdict(tmp_path):
    store = ResultStore(tmp_path, None)
    for stored in STORE.results("mountain-car", "circuit", BudgetName.PUBLISHED)[:2]:
        store.save(stored)
    found = {claim.name: claim for claim in _estimate_claims(store)}
    claim = found["published-mountain-car"]
    assert (claim.verdict, claim.figure) == (Finding.NOT_TESTED, "2 runs came to their end")
    assert claim.command.endswith("--budget published --task mountain-car")


def test_runs_of_an_agent_are_not_those_of_a_longer_name(tmp_path):
    store = ResultStore(tmp_path, None)
    run = ResultStore(Path("nowhere")).results("mountain-car", "cfc")[0]
    for agent in ("cfc", "cfc-wide"):
        store.save(run.model_copy(update={"name": run.name.model_copy(update={"agent": agent})}))
    assert [len(store.results("mountain-car", agent)) for agent in ("cfc", "cfc-wide")] == [1, 1]


def test_every_table_of_the_paper_and_every_supplement_table_is_in_the_list(claims):
    sources = " ".join(claim.source for claim in claims)
    for number in ("Table I", "Table II", "Table III", "Table IV", *(f"S{n}" for n in range(1, 8))):
        assert number in sources, number
    for which in TABLES:
        for row in table(which, ResultStore(Path("nowhere"))):
            assert row.published is None or any(
                claim.name == f"{which}-{row.task}-{row.agent}" for claim in claims
            )


def test_a_published_value_has_one_verdict(claims):
    verdicts = {}
    for claim in claims:
        if claim.name.startswith(tuple(f"{which}-" for which in TABLES)):
            verdicts.setdefault(claim.claim, set()).add((claim.verdict, claim.figure, claim.why))
    assert len(verdicts) < sum(len(table(which, STORE)) for which in TABLES)  # some stand in two tables
    assert {len(found) for found in verdicts.values()} == {1}


def test_the_two_values_of_a_task_are_those_of_all_runs_and_of_the_successes(tmp_path):
    found = {claim.name: claim for claim in two_values(STORE)}
    pendulum, cheetah = found["two-values-pendulum"], found["two-values-half-cheetah"]
    assert pendulum.verdict is Finding.DIFFERENCE
    assert "9 of 10 runs succeed" in pendulum.figure
    for part in ("n = 10 and 10", "n = 9 and 9", "difference 195.6", "difference 5.482"):
        assert part in pendulum.figure
    assert pendulum.command.endswith("--budget published")
    assert cheetah.verdict is Finding.NOT_REPRODUCED
    store = ResultStore(tmp_path, None)
    for stored in STORE.results("pendulum", "circuit", BudgetName.PUBLISHED):
        seed = stored.name.seed
        store.save(stored.model_copy(update={"mean": 200.0 + seed, "success": seed > 3}))
    pendulum, cheetah = two_values(store)
    assert pendulum.verdict is Finding.NOT_REPRODUCED  # 204 to 209 are not the paper's 1168.5
    assert cheetah.verdict is Finding.NOT_TESTED


def test_each_p_value_has_its_test_n_and_effect_size(claims):
    tested = [claim.figure for claim in claims if "p = " in claim.figure]
    assert len(tested) > 70
    number = r"-?[\d,.]+"
    sentence = (
        rf"difference {number} \({number} \.\. {number}\)(, P\(above\) {number})?; "
        rf"(permutation|Welch's|Fisher's) test, n = \d+ and \d+, p = {number}"
    )
    for figure in tested:
        assert len(re.findall(sentence, figure)) == figure.count("p = "), figure


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
    prefixes = ("mlp-", "lstm-", "ppo-", "a2c-", *(f"{which}-" for which in TABLES))
    rates = {f"published-{task}" for task in ("pendulum", "mountain-car", "cart-pole")}
    for claim in claims:
        if claim.name.startswith(prefixes) or claim.name in rates:
            assert claim.verdict is not Finding.REPRODUCED or claim.name.startswith(("ppo-", "a2c-"))
            if claim.verdict is Finding.DIFFERENCE:
                assert "does not prove" in claim.why or "both agents reach the limit" in claim.why


def test_a_lower_rate_on_random_robots_is_no_reproduction(monkeypatch):
    rates = {"circuit": 0.95, "cfc": 0.99, "ltc": 0.951}

    def robust(agent):
        return {ranges: {"success_rate": rates[agent]} for ranges in ("harsh", "unseen")}

    monkeypatch.setattr(successors, "_robust", robust)
    cfc, ltc = successors.successor_claims()
    assert cfc.verdict is Finding.NOT_REPRODUCED
    assert "950 against 990 of 1,000" in cfc.figure
    assert (ltc.verdict, "does not prove" in ltc.why) == (Finding.DIFFERENCE, True)


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
