"""Runs of the paper's grid: made once, the same bits again, replayed to their returns."""

import subprocess
import sys

import pytest
from kit.paths import ROOT

from paper.runs import budget_for, replay, select, train_run
from paper.store import BudgetName, RunName
from rover_ncp.core.errors import UsageError

QUICK = BudgetName.QUICK
CAR = RunName(task="mountain-car", agent="circuit", seed=0, budget=QUICK)


@pytest.fixture(scope="module")
def car():
    return train_run(CAR)


def command(*arguments):
    """Return what a command prints."""
    line = [sys.executable, "-m", "paper", *arguments]
    return subprocess.run(line, cwd=ROOT, check=True, capture_output=True, text=True).stdout


def comparable(result):
    return result.model_dump(exclude={"wall_s", "cpu_s"})


def test_the_same_run_gives_the_same_bits_and_replays(car):
    again = train_run(CAR)
    assert comparable(again) == comparable(car)
    assert replay(car) == car.score
    assert car.evaluations == 1 + budget_for(CAR).iterations
    other = train_run(CAR.model_copy(update={"seed": 1}))
    assert other.parameters != car.parameters


@pytest.mark.parametrize(
    ("task", "agent"),
    [
        ("cart-pole", "random"),
        ("parking", "circuit"),
        ("pendulum", "mlp"),
        pytest.param("cart-pole", "lstm", marks=pytest.mark.long),
        pytest.param("pendulum", "circuit", marks=pytest.mark.long),
    ],
)
def test_a_quick_run_improves_and_replays(task, agent):
    result = train_run(RunName(task=task, agent=agent, seed=0, budget=QUICK))
    assert replay(result) == result.score
    assert result.curve[-1][2] > result.curve[0][2]
    bonus = 1.2 if task == "pendulum" else 1.0
    assert result.plain_mean <= result.mean <= max(bonus * result.plain_mean, result.plain_mean)


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


@pytest.mark.long
def test_command_makes_runs_once_and_replays_them(tmp_path):
    runs = f"--task mountain-car --agent circuit --seed 0 --budget quick --results {tmp_path}".split()
    assert command("run", *runs, "--processes", "1").endswith("1 runs made, 0 found\n")
    assert command("run", *runs) == "0 runs made, 1 found\n"
    assert command("replay", *runs) == "1 runs replayed, 1 to the last bit, 0 differ\n"
