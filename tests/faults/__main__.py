"""Inject every fault of the safety matrix, at random moments, in processes that keep running.

    make soak                                              # 20 minutes, seed 0
    PYTHONPATH=tests python -m faults --minutes 20 --seed 1

Mock Pioneer, bridge, links and drivers run as real processes on this machine. For each fault the time to
standstill is measured, by the rover's true motion, and compared with the bound of its row. Then the
fault is removed and the rover drives again. At the end the rover must stand still, bridge and mock must hold
no more memory, threads or files than at the beginning, and the recordings must hold every message that
their drivers could receive. All rows need about ten minutes; a short soak lists those that it did not reach.
"""

import argparse
import csv
import shutil
import sys
from functools import partial
from pathlib import Path

from faults.soak import soak

OUT = Path("runs/soak")
"""Recordings, logs and the table; those of an earlier soak are deleted."""


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m faults")
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=0, help="of the order, the drivers and the moments")
    given = parser.parse_args()
    shutil.rmtree(OUT, ignore_errors=True)
    soaked = soak(given.minutes * 60.0, given.seed, OUT, partial(print, flush=True))
    table, failed = OUT / "soak.csv", soaked.failed()
    with table.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(soaked.table())
    print(
        f"{len(soaked.rounds)} faults in {soaked.wall_s / 60.0:.1f} minutes, load {soaked.load:.1f}; {table}"
    )
    if soaked.not_reached:
        print("not reached: " + ", ".join(row.key for row in soaked.not_reached))
    print("\n".join(f"failed: {each}" for each in failed) or "all checks passed")
    sys.exit(1 if failed else 0)
