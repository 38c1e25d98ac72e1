"""Verdicts on the paper's claims, and the report."""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from kit.paper_runs import result
from kit.paths import ROOT

from paper import claims
from paper.claims import Claim, Verdict, judge_claims, load_claims, readings
from paper.report import summary_of
from paper.store import Packed, ResultStore
from paper.tasks import TASKS, build_agent
from rover_ncp.neurons.interpretation import Sign


@pytest.fixture
def store(tmp_path):
    return ResultStore(tmp_path)


def fill(store, task, agent, means, **changes):
    for seed, mean in enumerate(means):
        store.save(result(task, agent, seed, mean, success=mean >= TASKS[task].success, **changes))


def verdict(store, test, *, others=(), why="", **arguments):
    claim = Claim(name="a", words="", where="here", test=test, arguments=arguments, why=why)
    return judge_claims(store, [claim, *others])[0]


@pytest.mark.parametrize(
    ("hits", "of", "theirs", "expected"),
    [
        (10, 10, (12, 12), Verdict.UNDECIDED),  # the rate of ten runs is not known within the margin
        (48, 48, (48, 48), Verdict.HOLDS),
        (2, 12, (12, 12), Verdict.DIFFERS),
        (4, 4, (12, 12), Verdict.NOT_TESTED),
    ],
)
def test_rate_needs_an_interval_within_the_margin(store, hits, of, theirs, expected):
    fill(store, "parking", "circuit", [-0.05] * hits + [-3.0] * (of - hits))
    found = verdict(store, "rate", task="parking", hits=theirs[0], of=theirs[1])
    assert found.verdict is expected
    if expected is Verdict.UNDECIDED:
        assert found.why == "p = 1, n = 10 and 12"


def test_value_is_equal_within_the_margin_or_differs(store):
    fill(store, "mountain-car", "mlp", [95.0, 96.0, 97.0, 96.5, 95.5])
    values = {"task": "mountain-car", "agent": "mlp", "std": 1.0}
    assert verdict(store, "value", mean=96.5, **values).verdict is Verdict.HOLDS
    assert verdict(store, "value", mean=80.0, **values).verdict is Verdict.DIFFERS
    wide = verdict(store, "value", mean=92.0, **values | {"std": 30.0})
    assert wide.verdict is Verdict.UNDECIDED
    assert wide.why.startswith("p = ")


def test_comparison_is_better_on_par_or_open(store):
    fill(store, "pendulum", "circuit", [1100.0, 1110.0, 1120.0, 1130.0, 1140.0])
    fill(store, "pendulum", "random", [100.0, 200.0, 300.0, 1100.0, 50.0])
    fill(store, "pendulum", "mlp", [1101.0, 1112.0, 1121.0, 1132.0, 1141.0])
    fill(store, "pendulum", "lstm", [1191.0, 1192.0, 1193.0, 1194.0, 1199.0])
    fill(store, "pendulum", "ppo", [1150.0, 1155.0, 1160.0, 1165.0, 1170.0], budget="gradients")
    pendulum = {"task": "pendulum"}
    assert verdict(store, "compare", other="random", better=True, **pendulum).verdict is Verdict.HOLDS
    assert verdict(store, "compare", other="mlp", better=True, **pendulum).verdict is Verdict.UNDECIDED
    assert verdict(store, "compare", other="mlp", **pendulum).verdict is Verdict.HOLDS
    assert verdict(store, "compare", other="lstm", **pendulum).verdict is Verdict.DIFFERS
    nearly = verdict(store, "compare", other="ppo", other_budget="gradients", **pendulum)
    assert nearly.verdict is Verdict.HOLDS  # surely worse, and surely by less than the margin
    assert verdict(store, "compare", other="a2c", **pendulum).verdict is Verdict.NOT_TESTED


def test_p_is_corrected_for_the_claims_of_one_place(store):
    fill(store, "mountain-car", "mlp", [90.0, 95.0, 100.0, 92.0, 97.0])
    arguments = {"task": "mountain-car", "agent": "mlp", "mean": 87.0, "std": 6.0}
    assert verdict(store, "value", **arguments).verdict is Verdict.DIFFERS
    others = [
        Claim(name=f"b{n}", words="", where="here", test="value", arguments=arguments) for n in range(9)
    ]
    assert verdict(store, "value", others=others, **arguments).verdict is Verdict.UNDECIDED
    apart = [other.model_copy(update={"comparable": False}) for other in others]
    assert verdict(store, "value", others=apart, **arguments).verdict is Verdict.DIFFERS
    assert judge_claims(store, apart[:1])[0].verdict is Verdict.NOT_TESTED


def test_definition_1_is_read_with_and_without_the_rest_at_three_thresholds():
    # In 28 ticks at rest the two move apart, in 20 of driving alike.
    source, target = np.arange(48.0), np.concatenate([-np.arange(28.0), np.arange(20.0) - 27.0])
    poses = np.zeros((49, 3))
    poses[29:, 0] = 0.01 * np.arange(1, 21)
    drive = SimpleNamespace(potentials=np.column_stack([source, target]), poses=poses)
    policy = SimpleNamespace(circuit=SimpleNamespace(index=["AVA", "RGT"].index))
    found = readings(policy, drive, "AVA", "RGT")
    assert found == {Sign.POSITIVE: 6, Sign.ANTAGONISTIC: 2, Sign.PHASE_SWITCHING: 4}


@pytest.mark.parametrize(
    ("positive", "antagonistic", "expected"),
    [
        (5, 0, Verdict.NOT_TESTED),  # not even equal signs could decide
        (6, 0, Verdict.HOLDS),
        (0, 6, Verdict.DIFFERS),
        (7, 1, Verdict.UNDECIDED),
    ],
)
def test_sign_is_decided_by_the_sign_test_over_clear_circuits(
    store, monkeypatch, positive, antagonistic, expected
):
    clear = [{Sign.POSITIVE: 12}] * positive + [{Sign.ANTAGONISTIC: 12}] * antagonistic
    signs = iter([*clear, {Sign.NONE: 12}])
    monkeypatch.setattr(claims, "drives", lambda _: [(None, None)] * (len(clear) + 1))
    monkeypatch.setattr(claims, "readings", lambda *_: next(signs))
    found = verdict(store, "sign", source="AVA", destination="RGT", expected="positive")
    assert found.verdict is expected


def test_summary_counts_each_claim_once(store):
    file = load_claims()
    judged = judge_claims(store, file.claims)
    rows = [line.strip("| ").split(" | ") for line in summary_of(file, judged).splitlines()[2:]]
    assert [row[0] for row in rows] == list(Verdict)
    counts = np.array([row[1:] for row in rows], int)
    assert counts.sum() == len(file.claims)
    assert counts[:, 0].sum() == len({name for names in file.questions.values() for name in names})


def test_command_reports_runs_and_draws_their_curves(store, tmp_path):
    untuned = Packed.of(build_agent(TASKS["parking"], "circuit", 0).parameters())
    fill(store, "parking", "circuit", [-0.05] * 5, parameters=untuned)
    picture = tmp_path / "curves.png"
    options = ["--results", str(tmp_path), "--curves", str(picture), "--long"]
    done = subprocess.run(
        [sys.executable, "-m", "paper", "report", *options], cwd=ROOT, check=True, capture_output=True
    )
    assert picture.read_bytes().startswith(b"\x89PNG")
    rows = {line.split(" | ")[0].strip("| "): line for line in done.stdout.decode().splitlines()}
    for name, verdict in {
        "size": "not tested",
        "parameters-mlp": "does not hold",
        "park-all": "undecided",
    }.items():
        assert f"| {verdict}" in rows[name]
