"""``park`` trains, judges and drives one course and one robot, a number of agents, not of seconds."""

import pytest

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.cli import run
from rover_ncp.core.console import Output
from rover_ncp.course.course import load_course
from rover_ncp.course.slowdown import slowed
from rover_ncp.robot.description import load_description
from sim.learn.settings import load_task
from sim.park import park
from sim.world.described import default_rover, described_rover

SLOW = """\
format: 1
name: slow
based_on: p3at-sh
motion: {v_max: 0.08, omega_max: 0.09}
"""


class StoppedError(Exception):
    """The training was asked for and would begin."""


@pytest.fixture
def asked(monkeypatch):
    """What ``park`` asks of the training, and the rollouts by which it accepts a policy."""
    found = {"rollouts": []}

    def train(settings, folder, *, on_progress, accept, block):
        found.update(settings=settings, accept=accept)
        raise StoppedError

    def rollout(policy, course, model=None):
        found["rollouts"].append((course, model or default_rover()))
        return real(policy, course, model)

    real = park.rollout
    monkeypatch.setattr(park, "train", train)
    monkeypatch.setattr(park, "rollout", rollout)
    return found


def run_park(tmp_path, model="p3at-sh"):
    out = tmp_path / "park"
    return park.run_park(
        Output(False), policy=None, course="parking", model=model, seed=None, out=out, overwrite=False
    )


def begin(asked, tmp_path, **options):
    with pytest.raises(StoppedError):
        run_park(tmp_path, **options)
    return asked["settings"], asked["accept"]


def test_a_slow_robot_is_trained_and_judged_as_it_is_driven(asked, tmp_path):
    (tmp_path / "slow.yaml").write_text(SLOW)
    model = str(tmp_path / "slow.yaml")
    settings, accept = begin(asked, tmp_path, model=model)
    robot = load_description(model)
    course, pace = slowed(load_course("parking"), robot)
    assert pace
    task = load_task(settings)
    assert (task.course, task.rover) == (course, described_rover(robot))
    accept(load_policy("parking"))
    assert asked["rollouts"] == [(course, described_rover(robot))]


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ("--policy course", "--seed: nothing is trained with --policy"),
        ("--model turtlebot4", "--seed: nothing is trained for a ROS 2 robot: policy course parks"),
        ("--dock", "--seed: does not go with --dock"),
    ],
)
def test_seed_without_a_training_is_an_error(tmp_path, capsys, options, reason):
    out = tmp_path / "park"
    assert run(["park", *options.split(), "--seed", "0", "--out", str(out)]) == 2
    assert reason in capsys.readouterr().err
    assert not out.exists()


def test_the_training_ends_with_an_agent_that_parks_well(asked, tmp_path):
    settings, accept = begin(asked, tmp_path)
    assert not accept(load_policy("reverse"))  # it parks elsewhere
    assert accept(load_policy("parking"))
    assert (settings.agents, settings.iterations) == (park.AGENTS, park.ITERATIONS)
