"""Verdicts on the paper's claims, and the report."""

from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from kit.paper_runs import result
from typer.testing import CliRunner

from paper import claims
from paper.__main__ import app
from paper.claims import Claim, Verdict, judge_claims, readings
from paper.runs import PAIRS
from paper.store import Packed, ResultStore
from paper.tasks import TASKS, build_agent
from rover_ncp.neurons.interpretation import Sign


@pytest.fixture
def store(tmp_path):
    return ResultStore(tmp_path)


def fill(store, task, agent, means, **changes):
    for seed, mean in enumerate(means):
        store.save(result(task, agent, seed, mean, success=mean >= TASKS[task].success, **changes))


def verdict(store, test, *, others=(), **arguments):
    claim = Claim(words="", where="here", test=test, arguments=arguments)
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
    nearly = verdict(store, "compare", other="ppo", **pendulum)
    assert nearly.verdict is Verdict.HOLDS  # surely worse, and surely by less than the margin
    assert verdict(store, "compare", other="a2c", **pendulum).verdict is Verdict.NOT_TESTED


def test_p_is_corrected_for_the_claims_of_one_place(store):
    fill(store, "parking", "circuit", [-0.05] * 3 + [-3.0] * 3)
    arguments = {"task": "parking", "hits": 12, "of": 12}
    assert verdict(store, "rate", **arguments).verdict is Verdict.DIFFERS
    others = [Claim(words="", where="here", test="rate", arguments=arguments) for _ in range(9)]
    assert verdict(store, "rate", others=others, **arguments).verdict is Verdict.UNDECIDED
    apart = [other.model_copy(update={"why": "another plant"}) for other in others]
    assert verdict(store, "rate", others=apart, **arguments).verdict is Verdict.DIFFERS
    assert judge_claims(store, apart[:1])[0].verdict is Verdict.NOT_COMPARABLE


def test_algorithm_1_is_refuted_only_if_every_setting_is(store):
    def train(setting, successes):
        for seed in range(12):
            mean = -0.05 if seed < successes else -3.0
            run = result("parking", "circuit", seed, mean, success=mean > -0.1, budget="algorithm1")
            name = run.name.model_copy(update={"setting": setting})
            store.save(run.model_copy(update={"name": name}))

    arguments = {"task": "parking", "hits": 12, "of": 12}
    for pair in PAIRS[:-1]:
        train(pair, 0)
    assert verdict(store, "algorithm1", **arguments).why.startswith("11 of 12 settings; 5 runs are missing")
    train(PAIRS[-1], 1)
    found = verdict(store, "algorithm1", **arguments)
    assert found.verdict is Verdict.DIFFERS
    assert found.figure == "1 of 144 runs of 12 settings, the best 1 of 12"
    train(PAIRS[0], 10)
    assert verdict(store, "algorithm1", **arguments).verdict is Verdict.UNDECIDED


def test_algorithm_1_is_not_refuted_once_a_setting_succeeds_as_often_whatever_the_others_do(store):
    for seed in range(5):
        run = result("pendulum", "circuit", seed, 1180.0, success=True, budget="algorithm1")
        store.save(run.model_copy(update={"name": run.name.model_copy(update={"setting": PAIRS[0]})}))
        found = verdict(store, "algorithm1", task="pendulum", hits=12, of=12)
        assert found.verdict is Verdict.UNDECIDED
        assert ("runs are missing" in found.why) == (seed < 4)
    assert found.figure == "5 of 5 runs of 1 settings, the best 5 of 5"


def test_definition_1_is_read_with_and_without_the_rest_at_three_thresholds():
    # In 28 ticks at rest the two move apart, in 20 of driving alike.
    source, target = np.arange(48.0), np.concatenate([-np.arange(28.0), np.arange(20.0) - 27.0])
    poses = np.zeros((49, 3))
    poses[29:, 0] = 0.01 * np.arange(1, 21)
    drive = SimpleNamespace(potentials=np.column_stack([source, target]), poses=poses)
    policy = SimpleNamespace(circuit=SimpleNamespace(index=["AVA", "RGT"].index))
    found = readings(policy, drive, "AVA", "RGT")
    assert Counter(found.values()) == {Sign.POSITIVE: 6, Sign.ANTAGONISTIC: 2, Sign.PHASE_SWITCHING: 4}


@pytest.mark.parametrize(
    ("positive", "antagonistic", "expected"),
    [
        (6, 0, Verdict.HOLDS),
        (0, 6, Verdict.DIFFERS),
        (7, 1, Verdict.UNDECIDED),
    ],
)
def test_sign_is_decided_by_the_sign_test_over_published_circuits(
    store, monkeypatch, positive, antagonistic, expected
):
    found = [Sign.POSITIVE] * positive + [Sign.ANTAGONISTIC] * antagonistic
    monkeypatch.setattr(
        claims, "signs", lambda _, budget, *pair: found if budget == "published" else [Sign.POSITIVE] * 60
    )
    judged = verdict(store, "sign", source="AVA", destination="RGT", expected="positive")
    assert judged.verdict is expected
    assert judged.against == "default search: 60 of 60"


def test_command_reports_runs(store, tmp_path):
    untuned = Packed.of(build_agent(TASKS["parking"], "circuit", 0).parameters())
    fill(store, "parking", "circuit", [-0.05] * 5, parameters=untuned)
    done = CliRunner().invoke(app, ["report", "--results", str(tmp_path)], catch_exceptions=False)
    [row] = [row for row in done.stdout.splitlines() if "learnt as often as by the published code" in row]
    assert "5 of 5" in row
    assert "| does not hold" in row


def test_best_half_cheetah_says_which_neuron_drives_which_joints(store, tmp_path):
    policy = build_agent(TASKS["half-cheetah"], "circuit", 0)
    vector = policy.parameters()
    [into, out_of] = (block.slice for block in policy.layout().blocks[-2:])
    vector[into][1], vector[out_of][[1, 6]] = (
        2.0,
        (0.5, -1.5),
    )  # pitch; REV on the thigh, FWD on the front one
    fill(store, "half-cheetah", "circuit", [900.0, 800.0], parameters=Packed.of(vector))
    lines = CliRunner().invoke(app, ["report", "--results", str(tmp_path)], catch_exceptions=False).stdout
    assert "| thigh | +0.00, -1.50 | +0.50, +0.00 | FWD |" in lines
    assert "PLM (+) and AVM (−): pitch +2.00" in lines
    assert "850.0 ± 70.7 (0%, 2 runs; mean 850.0 [214.7, 1485.3])" in lines
    [row] = [row for row in lines.splitlines() if "half-cheetah: circuit better than MLP" in row]
    assert "not tested (8 runs are missing, about " in row
