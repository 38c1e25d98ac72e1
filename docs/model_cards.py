"""The page of the shipped policies: the use of each, its training, its success by condition, its limits."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

from benchmarks.model_cards import CONDITIONS, RESULTS
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_policy


class About(NamedTuple):
    """What neither a policy's file nor a measurement says."""

    use: str
    limits: str


ABOUT = {
    "course": About(
        "Follows any course that the motors can drive: the default of `deploy` and `watch`.",
        "Longer courses and starts farther from the course park less often. It drives by the pose that it "
        "gets: with encoders alone on a skid-steered base, its error is the error at the goal. It "
        "does not sense obstacles. No real robot has been measured. "
        "[More conditions](../sim_to_real.md#results).",
    ),
    "dock": About(
        "The last 0.6 m of a docking, within 2 cm and 2°: what `deploy --to` drives from the staging pose.",
        "Its own course only. It needs external poses, as from tags. Measured in simulation only. "
        "[Whole dockings](../place.md#in-simulation).",
    ),
    "parking": About(
        "The paper's form: absolute pose in, the paper's wiring, one course. For comparison with the paper.",
        "One course, one start, one robot: it loses most trials as soon as the start or the robot differs. "
        "Do not choose it for a real robot.",
    ),
    "reverse": About(
        "Backs into a bay, from the absolute pose, with one neuron more for reverse.",
        "One course, one start, one robot, as `parking`. Do not choose it for a real robot.",
    ),
}


def models_page() -> str:
    """Return the page of model cards."""
    results = json.loads(RESULTS.read_text())
    parts = [
        "# Shipped policies",
        "Success by condition, judged by the true pose; `--randomize` names a "
        "[randomization](files.md#randomization). `python -m benchmarks.model_cards` measures it again.",
    ]
    for name, rows in CONDITIONS.items():
        parts += [f"## {name}", ABOUT[name].use, _facts(load_policy(name)), _success(rows, results)]
        parts.append(f"Limits: {ABOUT[name].limits}")
    return "\n\n".join(parts) + "\n"


def _facts(policy: Policy) -> str:
    made = policy.provenance
    circuit, settings = policy.circuit, made["settings"]
    if "rollouts" in settings:
        spent = (
            f"{settings['iterations']:,} generations, up to {settings['rollouts']} trials for each candidate"
        )
    else:
        spent = f"the best of {settings['agents']} agents, {settings['iterations']:,} iterations each"
    versions = [f"{name} {version}" for name, version in made["made_with"].items() if name != "commit"]
    command = f"`{made['command']}`"
    if "rollouts" in settings:
        commit = made["made_with"]["commit"][:8]
        command += f" made it at commit {commit}; this version drives other random trials, and makes another"
    rows = {
        "circuit": f"{len(circuit.neurons)} neurons, {len(circuit.kind)} synapses",
        "observes": ", ".join(f"`{name}`" for name in policy.sensing.inputs),
        "commands": ", ".join(f"`{name}`" for name in policy.motors.outputs),
        "trained on": f"course `{settings['course']}`, "
        + (f"randomization `{settings['randomize']}`" if "randomize" in settings else "the nominal rover"),
        "training": spent,
        "command": command,
        "made with": ", ".join(versions),
    }
    return "\n".join(["| | |", "|---|---|", *(f"| {key} | {value} |" for key, value in rows.items())])


def _success(rows: Mapping[str, str], results: Mapping[str, Any]) -> str:
    lines = [
        "| condition | parked | 95 % interval | position, heading error, p95 | command |",
        "|---|---|---|---|---|",
    ]
    for condition, command in rows.items():
        found = results[command]
        parked = round(found["success_rate"] * found["trials"])
        interval = "–".join(f"{100 * bound:.1f}" for bound in found["success_ci95"]) + " %"
        lines.append(
            f"| {condition} | {parked} of {found['trials']} | {interval if found['trials'] > 1 else ''} "
            f"| {1000 * found['error_m']['p95']:.0f} mm, {found['error_rad']['p95'] * 57.29578:.1f}° "
            f"| `rover-ncp {command}` |"
        )
    return "\n".join(lines)
