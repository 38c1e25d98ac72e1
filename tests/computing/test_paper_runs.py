"""Runs of the paper's grid: made once, the same bits again, replayed to their returns."""

import pytest

from paper.runs import replay, select, train_run
from paper.store import BudgetName, RunName
from rover_ncp.core.errors import UsageError

QUICK = BudgetName.QUICK
CAR = RunName(task="mountain-car", agent="circuit", seed=0, budget=QUICK)


@pytest.fixture(scope="module")
def car():
    return train_run(CAR)


def comparable(result):
    return result.model_dump(exclude={"cpu_s"})


def test_the_same_run_gives_the_same_bits_and_replays(car):
    again = train_run(CAR)
    assert comparable(again) == comparable(car)
    assert replay(car) == car.score
    other = train_run(CAR.model_copy(update={"seed": 1}))
    assert other.parameters != car.parameters


def test_a_command_line_selects_runs():
    assert select(["cart-pole"], ["mlp"], [3]) == [RunName(task="cart-pole", agent="mlp", seed=3)]
    assert len(select(["cart-pole"], None, None)) == 10 * 4
    gradients = select(None, None, [0], BudgetName.GRADIENTS)
    assert {(name.task, name.agent) for name in gradients} == {
        (task, agent) for task in ("pendulum", "mountain-car") for agent in ("ppo", "a2c")
    }
    for wrong in (
        (["cart"], None, None),
        (None, ["gru"], None),
        (["half-cheetah"], ["ppo"], None),
        (["cart-pole"], ["circuit"], None, BudgetName.GRADIENTS),
    ):
        with pytest.raises(UsageError):
            select(*wrong)
