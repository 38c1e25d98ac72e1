"""How well robots are identified: whether the truth is within 1.96 standard deviations of each value.

    PYTHONPATH=tests python -m benchmarks.identify --robots 500 --seed 1 --randomize full

draws robots and drives each as `rover-ncp identify` does, through firmware, bridge and driver's code on a
virtual clock, with noisy external poses beside odometry. It prints a row for each value: the share of robots
whose 95 % interval holds the truth, their number, the median standard deviation, and the root mean square of
error over standard deviation. Values that were found to be zero have no interval and are not counted.
"""

import argparse
import multiprocessing
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np
from kit.identified import Error, driven, errors, robot, truth
from rich.progress import track

from deploy.identify.fit import identify
from deploy.identify.motion_log import motion_log
from sim.world.randomization import load_randomization

INTERVAL = 1.96
"""Standard deviations on both sides that hold 95 % of a Gaussian."""


def table(found: Iterable[dict[str, Error]]) -> Iterator[str]:
    """Yield the table: a row for each value, and one for ``all`` together."""
    pooled: dict[str, list[Error]] = {}
    for one in found:
        for key, error in one.items():
            pooled.setdefault(key, []).append(error)
    yield f"{'value':18} {'coverage':>8} {'n':>5} {'median ±':>9} {'rms error/σ':>11}"
    every = [error for row in pooled.values() for error in row]
    for key, row in [*sorted(pooled.items()), ("all", every)]:
        ratios = np.array([error / std for error, std in row])
        share, rms = np.mean(np.abs(ratios) <= INTERVAL), np.sqrt(np.mean(ratios**2))
        std = "" if key == "all" else f"{np.median([std for _, std in row]):.5f}"
        yield f"{key:18} {100 * share:6.1f} % {len(row):5} {std:>9} {rms:11.2f}"


def _study(name: str, seed: int, outside: bool, number: int) -> dict[str, Error]:
    ranges = load_randomization(name)
    trials = robot(ranges, seed, number)
    done = driven(trials, outside=outside, seed=number)
    profile = identify(motion_log(done.messages, None, done.lasting), "mock", done.bands)
    return errors(profile, truth(ranges, trials))


def main() -> None:
    """Print the coverage of robots 0 and on of a seed."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--robots", type=int, default=500)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--randomize", default="full", help="the preset that the robots are drawn from")
    options.add_argument("--odometry-only", action="store_true", help="without external poses")
    options.add_argument("--processes", type=int, default=2)
    chosen = options.parse_args()
    study = partial(_study, chosen.randomize, chosen.seed, not chosen.odometry_only)
    # Spawned, never forked: cffi does not survive a fork.
    with ProcessPoolExecutor(chosen.processes, multiprocessing.get_context("spawn")) as pool:
        found = list(track(pool.map(study, range(chosen.robots)), "robots", total=chosen.robots))
    print("\n".join(table(found)))


if __name__ == "__main__":
    main()
