"""Rovers that are carried or turned on the way, under a camera: how soon does the driver stop them?

    python -m sim.studies.carried --randomize varied --drives 100 --seed 1

drives each trial of the MuJoCo body through the stack, displaces the rover at a random moment of the way, and
prints how many drives the rule external-pose stopped, and after what time.
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rover_ncp.core.geometry import Pose
from rover_ncp.core.streams import Domain, random_stream
from rover_ncp.course.course import TICK_S, load_course
from sim.evaluate.driver import load_driver
from sim.pioneer.trial import Drawn
from sim.stack.camera import Camera
from sim.stack.trials import Stack
from sim.world.bodies import Body
from sim.world.randomization import load_randomization

CARRIED_M, TURNED_RAD, WITHIN_S = 0.3, 0.3, 2.0
WAY_S = 3.0, 12.0
"""The displacement comes between these times from the first tick, while the rover drives."""


@dataclass(frozen=True)
class CarriedStack(Stack):
    """Trials in which the rover is carried in a random direction, or turned to a random side."""

    turned: bool = False

    def displacement(self, number: int) -> tuple[int, Pose]:
        """Return tick and displacement of a trial."""
        stream = random_stream(self.seed, Domain.DISPLACEMENT, number)
        tick, direction = round(stream.uniform(*WAY_S) / TICK_S), stream.uniform(-math.pi, math.pi)
        if self.turned:
            return tick, Pose(0.0, 0.0, math.copysign(TURNED_RAD, direction))
        return tick, Pose(CARRIED_M * math.cos(direction), CARRIED_M * math.sin(direction), 0.0)

    def drawn(self, number: int) -> Drawn:
        """Return the robot of a trial, with its displacement."""
        drawn, (tick, by) = super().drawn(number), self.displacement(number)
        return drawn._replace(trials=drawn.trials._replace(bump=np.array([[tick, *by]])))

    def stopped_s(self, number: int) -> float:
        """Drive a trial; return the time from its displacement to the stop, infinite without one."""
        driven, (tick, _) = self.drive(number), self.displacement(number)
        return (driven.ticks - tick) * TICK_S if driven.reason == "stopped by external-pose" else math.inf


def main(arguments: Sequence[str] | None = None) -> None:
    """Drive and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--randomize", default="varied")
    parser.add_argument("--drives", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args(arguments)
    ranges = load_randomization(asked.randomize, Body.MUJOCO)
    for turned, words in ((False, f"carried by {CARRIED_M} m"), (True, f"turned by {TURNED_RAD} rad")):
        stack = CarriedStack(
            load_driver("course"),
            (load_course("parking"),),
            ranges,
            asked.seed,
            camera=Camera(),
            turned=turned,
        )
        times = np.array([stack.stopped_s(number) for number in range(asked.drives)])
        print(
            f"{asked.randomize}, {words}: {np.sum(times <= WITHIN_S)} of {asked.drives} stopped within "
            f"{WITHIN_S:g} s, {np.isfinite(times).sum()} at all; latest after {times.max():.1f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
