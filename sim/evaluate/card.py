"""The card of a policy: its file's hash, its training, and how often it parks under given conditions."""

import hashlib
import math
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.core.console import Output, reject
from rover_ncp.core.errors import UsageError
from rover_ncp.core.files import read_bytes, require_writable, resolve, shipped_names, write_atomic
from sim.evaluate.evaluate import Evaluation
from sim.evaluate.options import EvalOptions, Sensors
from sim.evaluate.results import EvalResult, measure
from sim.learn.settings import made_with
from sim.world.bodies import Body

SEED = 2026
"""With which no shipped policy was trained or chosen."""
TRIALS, STACK_TRIALS = 1000, 50
_MUJOCO = {"trials": STACK_TRIALS, "stack": True, "body": Body.MUJOCO, "randomize": "varied"}
ROBOTS: dict[str, dict[str, Any]] = {
    "nominal robot": {"trials": 1, "randomize": "none"},
    "`mild`: start within 5 cm and 5°": {"randomize": "mild"},
    "`full`: start within 10 cm and 10°": {"randomize": "full"},
    "`harsh`: lost commands, wheel mismatch, a push": {"randomize": "harsh"},
    "`skid`: skid-steer, pose from a localiser": {"randomize": "skid"},
    "MuJoCo, level floor, encoders alone": {**_MUJOCO, "sensors": Sensors.ENCODERS},
    "MuJoCo, level floor, gyro": {**_MUJOCO, "sensors": Sensors.GYRO},
}
"""By condition: options of ``eval`` in place of the usual ones; for every policy, on its own course."""
COURSES: dict[str, dict[str, Any]] = {
    "`full`, course `mirrored`": {"course": ["mirrored"], "randomize": "full"},
    "`full`, course `bay`": {"course": ["bay"], "randomize": "full"},
    "`full`, course `longer`": {"course": ["longer"], "randomize": "full"},
    "`full`, 200 random courses": {"random_courses": 200, "randomize": "full"},
}
"""The same for policies that follow a reference, and so any course."""


class CardRow(BaseModel):
    """How trials under one condition ended."""

    condition: str
    command: str = Field(description="that measures it alone")
    found: Evaluation = Field(description="how its trials ended")


class Card(BaseModel):
    """Result of the command ``eval --card``."""

    policy: str = Field(description="its name or file")
    sha256: str = Field(description="of the policy's file")
    card: str = Field(description="the file that was written")
    rows: list[CardRow] = Field(description="one for each condition")


def run_card(options: EvalOptions) -> int:
    """Measure a policy, write its card and return 0. Raises RoverNcpError."""
    asked = EvalOptions(policy=options.policy)
    given = {name: value for name, value in vars(options).items() if value != getattr(asked, name)}
    taken = {"policy", "course", "card", "overwrite", "processes", "json"}
    reject("does not go with --card", **{name: True for name in given if name not in taken})
    if len(options.courses) > 1:
        raise UsageError("--card: expected one --course, that of the policy")
    policy, path = load_policy(options.policy), Path(options.policy).with_suffix(".card.md")
    require_writable(path, overwrite=options.overwrite)
    output, rows = Output(options.json), list[CardRow]()
    for condition, changes in conditions(policy, options):
        row = replace(asked, processes=options.processes if "stack" in changes else None, **changes)
        found = measure(row)
        rows.append(CardRow(condition=condition, command=_command(options.policy, changes), found=found))
        output.say(f"{condition}: {_parked(found)}")
    digest = hashlib.sha256(read_bytes(resolve("policies", options.policy))).hexdigest()
    card = Card(policy=options.policy, sha256=digest, card=str(path), rows=rows)
    write_atomic(path, "\n".join(_lines(card, policy, options)) + "\n")
    output.result(card, f"card: {path}")
    return 0


def conditions(policy: Policy, options: EvalOptions) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the conditions for a policy, with their options of ``eval``."""
    settings = _mapping(policy.provenance.get("settings"))
    course = options.course or [str(settings.get("course", "parking"))]
    robots, trained = dict(ROBOTS), settings.get("randomize")
    if trained in {*shipped_names("randomizations")} - {row["randomize"] for row in ROBOTS.values()}:
        robots[f"`{trained}`: as trained"] = {"randomize": trained}
    usual = {"trials": TRIALS, "seed": SEED}
    for condition, changes in robots.items():
        yield condition, {"course": course, **usual, **changes}
    if RoverInterface(policy).needs_reference:
        for condition, changes in COURSES.items():
            yield condition, {**usual, **changes}


def _command(policy: str, changes: Mapping[str, Any]) -> str:
    words = ["rover-ncp", "eval", policy]
    for name, value in changes.items():
        option = f"--{name.replace('_', '-')}"
        words += [option] if value is True else [option, value[0] if isinstance(value, list) else str(value)]
    return shlex.join(words)


def _lines(card: Card, policy: Policy, options: EvalOptions) -> Iterator[str]:
    made = policy.provenance
    course = "".join(f" --course {name}" for name in options.course or [])
    facts = {
        "file": f"sha256 `{card.sha256}`",
        "circuit": f"{len(policy.circuit.neurons)} neurons, {len(policy.circuit.kind)} synapses",
        "observes": _code(policy.sensing.inputs),
        "commands": _code(policy.motors.outputs),
        "training": f"`{made['command']}`" if "command" in made else "the file does not say",
        "search": _search(_mapping(made.get("settings"))),
        "made with": _versions(_mapping(made.get("made_with"))),
        "measured with": _versions(made_with()),
    }
    yield from (f"# Policy {_cell(card.policy)}", "", "| | |", "|---|---|")
    yield from (f"| {name} | {_cell(text)} |" for name, text in facts.items())
    yield from (
        "",
        f"`rover-ncp eval {card.policy}{course} --card` writes this page, with `--json` the command "
        "of each row. The true pose is judged.",
        "",
        "| condition | parked | 95 % interval | position, heading error, 95th percentile |",
        "|---|---|---|---|",
    )
    for row in card.rows:
        interval = "–".join(f"{100 * bound:.1f}" for bound in row.found.success_ci95) + " %"
        yield (
            f"| {row.condition} | {_parked(row.found)} | {interval if row.found.trials > 1 else ''} "
            f"| {1000 * row.found.error_m.p95:.0f} mm, {math.degrees(row.found.error_rad.p95):.1f}° |"
        )


def _parked(found: EvalResult | Evaluation) -> str:
    return f"{round(found.success_rate * found.trials)} of {found.trials}"


def _search(settings: Mapping[str, Any]) -> str:
    """Return the search that found a policy, from the settings of its training."""
    if settings.get("randomize"):
        return "CMA-ES on random robots"
    return f"`{settings['search']}`" if "search" in settings else "the file does not say"


def _mapping(value: Any) -> Mapping[str, Any]:
    """Return part of a provenance, which may be anything in a file of unknown origin."""
    return value if isinstance(value, Mapping) else {}


def _versions(found: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {version}" for name, version in found.items()) or "the file does not say"


def _code(names: tuple[str, ...]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
