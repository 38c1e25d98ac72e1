"""Runs of the paper's grid: made once, the same bits again, replayed to their returns."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rover_ncp.circuit.policy_file import circuit_to_yaml
from rover_ncp.circuit.tap_withdrawal import tap_withdrawal_circuit
from rover_ncp.cli import run
from rover_ncp.core.errors import FileError, UsageError
from sim.paper.arena import Arena, draw_seeds
from sim.paper.cell import Cell, Name, Shelf, load_cell
from sim.paper.choice import chosen
from sim.paper.parking import ParkingArena, search_parking
from sim.paper.racing import Race, heats
from sim.paper.tasks import TASKS
from sim.paper.train import BudgetName, budget_for, replay, train_cell

QUICK = BudgetName.QUICK
CAR = Name(task="mountain-car", agent="circuit", seed=0)


@pytest.fixture(scope="module")
def car() -> Cell:
    return train_cell(CAR, QUICK)


@pytest.fixture
def arena() -> Arena:
    task = TASKS["cart-pole"]
    return Arena(task, task.policy(task.circuit()))


def test_the_same_run_gives_the_same_bits_and_replays(car):
    again = train_cell(CAR, QUICK)
    skip = {"wall_s", "cpu_s"}
    assert again.model_dump(exclude=skip) == car.model_dump(exclude=skip)
    assert {field: getattr(car, field) for field in replay(car)} == replay(car)
    assert car.steps <= 2 * budget_for(TASKS["mountain-car"], QUICK).steps
    other = train_cell(CAR.model_copy(update={"seed": 1}), QUICK)
    assert other.parameters != car.parameters


@pytest.mark.parametrize("agent", ["random", "lstm"])
def test_other_agents_run_and_replay(agent):
    cell = train_cell(Name(task="cart-pole", agent=agent, seed=2), QUICK)
    assert replay(cell)["mean"] == cell.mean
    assert cell.mean > 30.0  # an untuned agent falls after some 20 steps


def test_mujocos_run_replays():
    cell = train_cell(Name(task="roboschool", agent="circuit", seed=0), QUICK)
    assert replay(cell)["mean"] == cell.mean
    assert cell.plain_mean < cell.mean <= 1.2 * cell.plain_mean


def test_an_episode_depends_neither_on_its_lane_nor_on_its_company():
    for name in ("cart-pole", "pendulum"):
        task = TASKS[name]
        agent = task.policy(task.circuit())
        seeds = np.arange(40, dtype=np.uint64)
        vectors = np.tile(agent.parameters(), (40, 1))
        together = Arena(task, agent).run(vectors, seeds)
        alone = Arena(task, agent, lanes=1).run(vectors[7:9], seeds[7:9])
        assert alone.tolist() == together[7:9].tolist()
        assert len(set(together[:, 0].tolist())) > 1


def test_a_race_gives_winners_the_papers_estimate_and_losers_less_than_they_must_beat(arena):
    assert heats(20) == (1, 3, 9, 20)
    assert heats(1) == (1,)
    policy = TASKS["cart-pole"].policy(tap_withdrawal_circuit())
    vectors = np.tile(policy.parameters(), (3, 1))
    race = Race(arena, 5, 20, 10)
    keys = [(1, number) for number in range(3)]
    [first, *_] = race.estimate(vectors, np.full(3, -np.inf), keys)
    returns = arena.run(np.tile(vectors[0], (20, 1)), draw_seeds(5, keys[0], 20))[:, 0]
    assert first == pytest.approx(np.sort(returns)[:10].mean())
    steps = arena.steps
    lost = race.estimate(vectors, np.full(3, 400.0), keys)
    assert np.all(lost <= 400.0)
    assert arena.steps - steps < 3 * 60  # one rollout each


def test_a_shelf_finds_ones_own_run_before_the_shipped_one(car, tmp_path):
    shipped, own = Shelf(tmp_path / "shipped", None), Shelf(tmp_path / "own", tmp_path / "shipped")
    assert own.find(CAR) is None
    shipped.save(car)
    assert own.find(CAR) == CAR.path(tmp_path / "shipped")
    other = car.model_copy(update={"mean": 1.0})
    own.save(other)
    assert own.cells("mountain-car", "circuit") == [other]
    assert load_cell(shipped.find(CAR)) == car
    CAR.path(tmp_path / "own").write_text("{")
    with pytest.raises(FileError, match="damaged"):
        own.cells("mountain-car", "circuit")


def test_which_runs_a_command_line_means(tmp_path):
    assert chosen(["cart-pole"], ["mlp"], [3], None) == [Name(task="cart-pole", agent="mlp", seed=3)]
    assert len(chosen(["cart-pole"], None, None, None)) == 10 + 10 + 5 + 5
    own = chosen(["cart-pole"], None, [1], tmp_path / "mine.yaml")
    assert own == [Name(task="cart-pole", agent="mine", seed=1)]
    for wrong in (
        (["cart"], None, None, None),
        (None, ["gru"], None, None),
        (["half-cheetah"], ["ppo"], None, None),
        (None, None, None, tmp_path / "mine.yaml"),
    ):
        with pytest.raises(UsageError):
            chosen(*wrong)


def test_command_makes_runs_once_and_replays_them(tmp_path, capsys):
    wiring = tmp_path / "mine.yaml"
    wiring.write_text(circuit_to_yaml(tap_withdrawal_circuit()))
    common = ["--task", "mountain-car", "--circuit", str(wiring), "--seed", "0", "--json"]
    arguments = [*common, "--runs", str(tmp_path / "runs"), "--processes", "1"]
    assert run(["paper", "run", *arguments, "--budget", "quick"]) == 0
    [made] = json.loads(capsys.readouterr().out)["made"]
    assert (made["agent"], made["budget"]) == ("mine", "quick")
    assert run(["paper", "run", *arguments, "--budget", "quick"]) == 0
    assert json.loads(capsys.readouterr().out) == {"made": [], "found": 1}
    assert run(["paper", "replay", *arguments]) == 0
    assert json.loads(capsys.readouterr().out) == {"replayed": 1, "differ": []}


def test_a_users_mistake_is_one_line(tmp_path, capsys):
    assert run(["paper", "run", "--task", "cart", "--runs", str(tmp_path)]) == 2
    assert "no task 'cart'" in capsys.readouterr().err


def test_the_published_budget_is_the_papers():
    for name, iterations in (("pendulum", 25_000), ("mountain-car", 50_000), ("parking", 20_000)):
        budget = budget_for(TASKS[name], BudgetName.PUBLISHED)
        assert (budget.evaluations, budget.starts, budget.published) == (iterations, 1, True)


def test_without_heats_every_candidate_takes_all_rollouts(arena):
    vectors = np.tile(TASKS["cart-pole"].policy(tap_withdrawal_circuit()).parameters(), (2, 1))
    keys = [(1, 0), (1, 1)]
    plain = Race(arena, 5, 20, 10, heated=False).estimate(vectors, np.full(2, 400.0), keys)
    full = Race(arena, 5, 20, 10).estimate(vectors, np.full(2, -np.inf), keys)
    assert plain.tolist() == full.tolist()


def test_the_published_search_parks_too_when_asked_for():
    task = TASKS["parking"]
    policy = task.policy(task.circuit())
    budget = replace(budget_for(task, BudgetName.PUBLISHED), evaluations=60)
    found = search_parking(ParkingArena(task, policy), policy, 1, budget)
    assert found.ended == "evaluations"
    assert found.evaluations == 60
    assert found.curve[-1][1] == pytest.approx(ParkingArena(task, policy).outcome(found.vector).total)


def test_creeping_counts_as_a_miss_and_in_no_return():
    for name in ("parking", "four-dof"):
        task = TASKS[name]
        policy = task.policy(task.circuit())
        arena = ParkingArena(task, policy)
        untuned = policy.parameters()[None]
        plain, misses = arena.traces(untuned)
        values, counted, climbed = arena.traces_standing(untuned)
        assert values.tolist() == plain.tolist()
        assert climbed[:, :, : misses.shape[2]].tolist() == misses.tolist()
        assert counted == pytest.approx(-np.sum(climbed**2, axis=(1, 2, 3)))
        assert (counted < values).all()
        budget = replace(budget_for(task, BudgetName.DEFAULT), evaluations=300)
        found = search_parking(arena, policy, 1, budget)
        assert found.curve[-1][1] == ParkingArena(task, policy).outcome(found.vector).total


def test_runs_in_processes_are_those_of_one_process_and_an_interrupt_ends_them_all(tmp_path):
    code = "from rover_ncp.cli import main; main()"
    runs = ["--runs", str(tmp_path), "--again", "--task", "cart-pole", "--processes", "2"]
    command = [sys.executable, "-c", code, "paper", "run", *runs, "--agent", "mlp"]
    quick = [*command, "--seed", "0", "--seed", "1", "--budget", "quick"]
    subprocess.run(quick, check=True, capture_output=True, timeout=110)
    for seed in (0, 1):
        name = Name(task="cart-pole", agent="mlp", seed=seed)
        assert load_cell(name.path(tmp_path)).parameters == train_cell(name, QUICK).parameters
    long = [*command, "--budget", "published"]
    process = subprocess.Popen(
        long, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, start_new_session=True
    )
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    wait_for(lambda: len(children.read_text().split()) >= 3)  # the resource tracker, and two runs
    started = children.read_text().split()
    os.killpg(process.pid, signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert b"Traceback" not in stderr
    wait_for(lambda: not any(Path(f"/proc/{child}").exists() for child in started))


def wait_for(condition):
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)
