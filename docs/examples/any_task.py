"""A circuit learns any Gymnasium environment: CMA-ES searches its parameters.

python any_task.py ENVIRONMENT POLICY.yaml GENERATIONS OUT.yaml

An entry of the observation is an input of the policy, in the order of ``sensing.inputs``. An entry of the
action is an output, in the order of ``motors.outputs``. Where actions are numbers 0 to n - 1, the largest of
n outputs chooses one.
"""

import sys
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
from cmaes import CMA

from rover_ncp.circuit.policy_file import load_policy, policy_to_yaml
from rover_ncp.circuit.runner import Runner

EPISODES = 8  # of a candidate
FRESH = 10**6  # the first seed of the episodes that score a mean or the result


def play(environment, runner, seed):
    """Return the return of one episode."""
    runner.reset()
    seen, _ = environment.reset(seed=seed)
    space, total, over = environment.action_space, 0.0, False
    while not over:
        outputs = np.array(runner.tick([float(number) for number in seen]))
        if isinstance(space, gymnasium.spaces.Discrete):
            action = int(space.start + outputs.argmax())
        else:
            action = np.clip(outputs, space.low, space.high).astype(space.dtype)
        seen, reward, terminated, truncated, _ = environment.step(action)
        total, over = total + float(reward), terminated or truncated
    return total


def score(environment, policy, episodes=100, first=FRESH):
    """Return the mean return of the episodes with consecutive seeds."""
    runner = Runner(policy)
    return sum(play(environment, runner, first + number) for number in range(episodes)) / episodes


def search(environment, policy, generations, seed=0):
    """Return the policy of the best mean. All candidates of a generation play the same episodes."""
    layout = policy.layout()
    span = layout.upper - layout.lower
    start = (policy.parameters() - layout.lower) / span

    def at(point):
        return policy.with_parameters(np.clip(layout.lower + point * span, layout.lower, layout.upper))

    noise = np.random.default_rng(seed).normal(0.0, 0.3, (1000, layout.size))  # few reach a distant goal
    best = max([start, *np.clip(start + noise, 0, 1)], key=lambda point: score(environment, at(point), 2, 0))
    cma = CMA(best, 0.1, bounds=np.tile([0.0, 1.0], (layout.size, 1)), seed=seed)
    most = score(environment, at(best), EPISODES)
    for generation in range(generations):
        points = [cma.ask() for _ in range(cma.population_size)]
        returns = [score(environment, at(point), EPISODES, generation * EPISODES) for point in points]
        cma.tell([(point, -each) for point, each in zip(points, returns, strict=True)])
        value = score(environment, at(cma.mean), EPISODES)
        best, most = (cma.mean, value) if value > most else (best, most)
        print(f"generation {generation + 1} of {generations}: best mean {most:.4g}")
    return at(best)


def main(name, start, generations, out):
    """Train, score the untrained and the trained policy in fresh episodes, and write the trained one."""
    sys.path.insert(0, "")  # a module in the working folder may register the environment
    environment, policy = gymnasium.make(name), load_policy(start)
    found = replace(search(environment, policy, int(generations)), provenance={"environment": name})
    Path(out).write_text(policy_to_yaml(found))
    before, after = score(environment, policy), score(environment, found)
    print(f"{out}: return {after:.4g}, untrained {before:.4g}")


if __name__ == "__main__":
    main(*sys.argv[1:])
