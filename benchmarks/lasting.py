"""Is the driver certain only where it is right? Trials whose errors last, appended to a file.

    python -m benchmarks.lasting drives.jsonl --rows E1 E6 --trials 100 --seed 1
    python -m benchmarks.lasting drives.jsonl --table

The first command drives the trials that the file does not have yet. It appends one line of JSON for each as
it ends. A line belongs to its row, seed, number, estimator settings (``--set``) and to the digests of the
row's settings and of the driver's code. So a command that was stopped continues when it is repeated. Rows:

- E1 to E3: a localiser whose error lasts; E3 tells less than its error, and does not declare that it lasts
- E4, E5: dockings; E4's localiser tells and declares its lasting error, E5's does not
- E3-false, E5-false: the same with a localiser that falsely declares the errors of tags
- E6, E7: a floor of squares with two frictions
- E8, E9: a Husky with the masses of its URDF, to one side as there, and centred
- scale, ramp, kicks, four, heavy: `benchmarks/odd_robots.py`
- varied, slope, lasting with gyro or camera; dock: dockings of varied robots
"""

import argparse
import hashlib
import json
import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from scipy.stats import binomtest, chi2

from benchmarks.ablation import changes_of, changes_words
from benchmarks.odd_robots import OddStack
from deploy.place.place import load_place
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.course.course import load_course
from rover_ncp.course.scoring import Parked
from rover_ncp.robot.description import load_description
from sim.evaluate.evaluate import fitted_courses
from sim.evaluate.results import DOCKED, stack_drive
from sim.learn.policies import any_policy
from sim.stack.docking import DockTrials
from sim.stack.trials import Stack, drive_each
from sim.world.bodies import Body
from sim.world.randomization import Randomization, load_randomization

PLAIN = {Parked.YES.value, DOCKED}
"""Verdicts that promise a success."""
ROOT = Path(__file__).parents[1]
DRIVER, CODE = ("bridge", "deploy", "rover_ncp"), {".py", ".cpp", ".h", ".yaml"}
INSIDE = float(chi2.ppf(0.95, 2))
"""Normalised squared errors up to this are inside the 95 % ellipse."""
HUSKY_LEFT_M = -0.085
"""Centre of mass of a Husky's base by husky.urdf.xacro of github.com/husky/husky at 03cff37. With its centred
wheels it is at -0.069 m; E8 takes the larger value for the whole robot, as one with a load has it."""


class Row(NamedTuple):
    """Trials of one kind."""

    sensors: str
    """gyro or camera; dock for dockings, which have both."""
    preset: str = "varied"
    localiser: dict[str, Any] | None = None
    skid_steer: Mapping[str, Any] = {}
    odd: str = ""
    """The kind of odd robot, if it is one."""
    model: str | None = None

    @property
    def ranges(self) -> Randomization:
        """The randomization: the preset with the row's changes."""
        fields = load_randomization(self.preset, Body.MUJOCO).model_dump(exclude_unset=True)
        fields["skid_steer"] |= self.skid_steer
        if self.localiser is not None:
            fields["localiser"] = self.localiser
        return Randomization.model_validate(fields)

    @property
    def digest(self) -> str:
        """The digest of these settings."""
        return hashlib.sha256(f"{self} {self.ranges}".encode()).hexdigest()[:8]

    def trials(self, seed: int, estimator: Mapping[str, float]) -> Stack | DockTrials:
        """Return the trials of a seed."""
        course = load_policy("course")
        if self.sensors == "dock":
            place = load_place(str(ROOT / "docs/examples/place.yaml"))
            return DockTrials(course, load_policy("dock"), place, self.ranges, seed, estimator=estimator)
        robot = load_description(self.model) if self.model else None
        courses, _ = fitted_courses([load_course("parking")], robot)
        gyro = self.sensors == "gyro"
        settings = any_policy("course"), tuple(courses), self.ranges, seed, gyro, not gyro, False, robot
        return OddStack(*settings, estimator, self.odd) if self.odd else Stack(*settings, estimator)


def lasting(position_m: float, heading_rad: float, time_s: float, **others: Any) -> dict[str, Any]:
    """Return the keys of a localiser whose error lasts."""
    return {
        "lasting_m": (position_m, position_m),
        "lasting_rad": (heading_rad, heading_rad),
        "lasting_s": (time_s, time_s),
        **others,
    }


def squares(size_m: float, friction: float, other: float) -> dict[str, Any]:
    """Return the keys of a floor of two frictions."""
    patches = {"size_m": (size_m, size_m), "friction": (other, other)}
    return {"friction": (friction, friction), "patches": patches}


def mass_left(left_m: float) -> dict[str, Any]:
    """Return the keys of a robot whose mass is so far to the left of its middle."""
    return {"mass_center_m": 0.0, "mass_left_m": (left_m, left_m)}


NOISE = {"noise_m": 0.005, "noise_rad": 0.005}
TOLD = {"told_m": 0.02, "told_rad": math.radians(2.0), "declared": {}}
NOT_TOLD = {"told_m": 0.0, "told_rad": 0.0, "declared": {}}
FALSE = {"declared": {"kind": "tags"}}
ROWS = {
    "E1": Row("camera", localiser=lasting(0.03, 0.026, 5.0, **NOISE)),
    "E2": Row("camera", localiser=lasting(0.08, 0.05, 20.0, **NOISE)),
    "E3": Row("camera", localiser=lasting(0.05, 0.03, 10.0, **NOISE, **TOLD)),
    "E4": Row("dock", localiser=lasting(0.01, math.radians(1.0), 5.0)),
    "E5": Row("dock", localiser=lasting(0.015, math.radians(1.0), 10.0, **NOT_TOLD)),
    "E3-false": Row("camera", localiser=lasting(0.05, 0.03, 10.0, **NOISE, **TOLD | FALSE)),
    "E5-false": Row("dock", localiser=lasting(0.015, math.radians(1.0), 10.0, **NOT_TOLD | FALSE)),
    "E6": Row("gyro", skid_steer=squares(0.8, 0.5, 0.9)),
    "E7": Row("gyro", skid_steer=squares(0.4, 0.3, 1.0)),
    "E8": Row("gyro", skid_steer=mass_left(HUSKY_LEFT_M), odd="husky", model="husky-a200"),
    "E9": Row("gyro", skid_steer=mass_left(0.0), odd="husky", model="husky-a200"),
    **{kind: Row("gyro", odd=kind) for kind in ("scale", "ramp", "kicks", "four")},
    "heavy": Row("gyro", "slope", odd="heavy"),
    **{
        f"{preset}-{sensors}": Row(sensors, preset)
        for preset in ("varied", "slope", "lasting")
        for sensors in ("gyro", "camera")
    },
    "dock": Row("dock"),
}


def code_digest() -> str:
    """Return the digest of the driver's code and data."""
    whole = hashlib.sha256()
    for folder in DRIVER:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in CODE:
                whole.update(f"{path.relative_to(ROOT)}\n".encode() + path.read_bytes())
    return whole.hexdigest()[:16]


class Key(NamedTuple):
    """What a line of the file belongs to, beside its trial's number."""

    driver: str
    row: str
    settings: str
    """Digest of the row's settings."""
    changes: str
    seed: int


def read(path: Path) -> dict[Key, dict[int, dict[str, Any]]]:
    """Return the trials of a file by key and number; a line that was cut off is left out."""
    found: dict[Key, dict[int, dict[str, Any]]] = defaultdict(dict)
    for text in path.read_text().splitlines() if path.exists() else ():
        try:
            line = json.loads(text)
        except ValueError:
            continue
        found[Key(**{name: line[name] for name in Key._fields})][line["trial"]] = line
    return found


def drive_row(path: Path, key: Key, estimator: Mapping[str, float], count: int, processes: int) -> None:
    """Drive the trials of a row that a file does not have yet, and append them."""
    known = read(path)[key]
    numbers = [number for number in range(count) if number not in known]
    trials = ROWS[key.row].trials(key.seed, estimator)
    whole = not path.exists() or path.read_text().endswith("\n")
    with path.open("a", buffering=1) as file:
        file.write("" if whole else "\n")
        for number, ended in drive_each(trials.drive, numbers, processes):
            file.write(json.dumps({**key._asdict(), **stack_drive(number, ended).model_dump()}) + "\n")


def share(part: int, whole: int) -> str:
    """Return a share with its Wilson interval in percent."""
    if not whole:
        return "0/0"
    low, high = binomtest(part, whole).proportion_ci(method="wilson")
    return f"{part}/{whole} ({100 * low:.1f}-{100 * high:.1f} %)"


class Tally:
    """Counts of a row's trials; of dockings, docked is the plain verdict."""

    def __init__(self, lines: Sequence[dict[str, Any]]) -> None:
        self.trials, self.parked = len(lines), sum(line["parked"] for line in lines)
        plain = [line["parked"] for line in lines if line["verdict"] in PLAIN]
        self.plain, self.false = len(plain), plain.count(False)
        errors = [line["squared"] for line in lines if line["squared"] is not None]
        self.inside = share(sum(error <= INSIDE for error in errors), len(errors))
        self.others = Counter(
            line["verdict"] or line["reason"] for line in lines if line["verdict"] not in PLAIN
        )

    def __str__(self) -> str:
        others = ", ".join(f"{self.others[end]} {end}" for end in sorted(self.others))
        counts = f"{self.trials:6d} {self.parked:6d} {self.plain:6d}"
        return f"{counts}  {share(self.false, self.plain):22s}  {self.inside:24s}  {others}"


def table(path: Path) -> Iterator[str]:
    """Yield the lines of a table of a file's trials, all seeds together, without rows that changed."""
    drives: dict[tuple[str, str], dict[str, list[dict[str, Any]]]] = defaultdict(lambda: defaultdict(list))
    for key, trials in read(path).items():
        if key.row in ROWS and key.settings == ROWS[key.row].digest:
            drives[key.driver, key.changes][key.row] += trials.values()
    for (driver, changes), rows in drives.items():
        yield f"driver {driver}, {changes} settings"
        yield (
            f"{'':14s} trials parked  plain  {'quiet misses':22s}  {'inside 95 % ellipse':24s}  "
            "other verdicts and stops"
        )
        tallies = {row: Tally(rows[row]) for row in ROWS if row in rows}
        yield from (f"{row:14s} {found}" for row, found in tallies.items())
        false, plain = (sum(getattr(each, of) for each in tallies.values()) for of in ("false", "plain"))
        yield f"quiet misses of all rows: {share(false, plain)}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Drive or print from the command line."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("file", type=Path)
    options.add_argument("--rows", nargs="+", choices=list(ROWS), default=list(ROWS))
    options.add_argument("--trials", type=int, default=10)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--processes", type=int, default=1)
    options.add_argument("--set", action="append", default=[], type=changes_of)
    options.add_argument("--table", action="store_true")
    given = options.parse_args(arguments)
    if not given.table:
        driver = code_digest()
        for row in given.rows:
            for changes in given.set or [{}]:
                key = Key(driver, row, ROWS[row].digest, changes_words(changes), given.seed)
                drive_row(given.file, key, changes, given.trials, given.processes)
    print("\n".join(table(given.file)))


if __name__ == "__main__":
    main()
