"""An explanation as files: a page and its numbers as JSON."""

from collections.abc import Sequence
from pathlib import Path

from rover_ncp.core.files import write_atomic
from rover_ncp.neurons.findings import number
from sim.explain.explain import Explanation
from sim.explain.what_if import STEP, Knockout, Sensitivity

SHOWN = 25
"""Parameters on the page; the JSON has them all."""
SENSITIVITIES = f"Change of the return when a parameter moves by {100 * STEP:g} % of its range"


NAMES = ("explanation.html", "explanation.json")
"""Files of an explanation."""


def write(found: Explanation, folder: Path) -> list[Path]:
    """Write the page and the numbers; return their paths. Raises FileError."""
    files = [folder / name for name in NAMES]
    write_atomic(files[0], page(found))
    write_atomic(files[1], found.result(files).model_dump_json(by_alias=True, indent=2) + "\n")
    return files


def page(found: Explanation) -> str:
    """Return an explanation as a page."""
    from deploy.view.page import Table, run_page
    from deploy.view.recorded_drive import KINDS
    from rover_ncp.course.shapes import OUTLINE, outline_of

    verdict = found.verdict
    parts = sorted(found.knock_outs, key=lambda row: row.total)
    return run_page(
        found.findings,
        found.interpretation,
        found.course,
        title=found.title,
        headline=(verdict.words.capitalize(), KINDS[verdict.words], verdict.reason),
        rows=[("Result", found.ending), ("Command", found.command)],
        outline=outline_of(found.robot) if found.robot else OUTLINE,
        tables=[
            Table(
                "Without a part",
                f"The simulation without each neuron and each synapse. The return of the whole circuit is "
                f"{number(found.simulated.total)}.",
                ["without", "return", "m from the goal", "parks"],
                [(_part(row), -row.change) for row in parts],
            ),
            Table(
                SENSITIVITIES,
                f"The {SHOWN} parameters with the largest loss of return.",
                ["parameter", "value", "lower", "higher"],
                [(_sensitivity(row), -row.worst) for row in _deepest(found)],
            ),
        ],
    )


def _part(row: Knockout) -> list[str]:
    return [row.title, number(row.total, ".2f"), f"{row.error_m:.2f}", "yes" if row.parked else "no"]


def _deepest(found: Explanation) -> Sequence[Sensitivity]:
    return sorted(found.sensitivities, key=lambda row: row.worst)[:SHOWN]


def _sensitivity(row: Sensitivity) -> list[str]:
    changes = [number(change, "+.3g") for change in (row.change_down, row.change_up)]
    return [row.title, f"{number(row.value)} {row.unit}".strip(), *changes]
