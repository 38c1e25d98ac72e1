"""An explanation as text and files: sections for terminal and Markdown, tables in CSV, page and picture."""

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from deploy.view.findings import number
from deploy.view.interpretation import SYMBOLS, THRESHOLD, Contribution
from rover_ncp.core.files import write_atomic
from sim.explain.explain import Explanation
from sim.explain.what_if import STEP, Knockout, Sensitivity

IN_TEXT, ON_PAGE = 12, 25
"""Parameters in the text and on the page; the CSV file has them all."""
MIN_CHANGE = 0.01
"""Least change of a drive's return that counts."""
MIN_SHARE = 0.01
"""Least change of a task's return that counts, as a share of the return."""


SENSITIVITIES = f"Change of the return when a parameter moves by {100 * STEP:g} % of its range"


class Section(NamedTuple):
    """A section of the text: a table with words before and after it."""

    title: str
    before: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    after: str


def sections(found: Explanation) -> Iterator[Section]:
    """Yield the sections of an explanation."""
    run, sign = found.findings, f"{THRESHOLD:g}"
    yield Section(
        "Contributions to the motor neurons",
        f"Definition 1, P/Q: + positive if P > {sign} Q, − antagonistic if Q > {sign} P, ± phase-switching.\n"
        "Vertical slopes, where the source's potential was constant, count.",
        ["from", *(f"to {motor}" for motor in run.motors)],
        [[name, *(_signs(run.contributions[name, motor]) for motor in run.motors)] for name in run.sources],
        "",
    )
    yield Section(
        "Time constants (s)",
        "",
        ["neuron", "this run"],
        [[row.neuron, f"{row.lowest_s:.3g} to {row.highest_s:.3g}"] for row in run.time_constants],
        "",
    )
    yield _without(found) if found.course is not None else _without_in_task(found)
    yield Section(
        SENSITIVITIES,
        "",
        ["parameter", "value", "lower", "higher"],
        [_sensitivity(row) for row in _deepest(found, IN_TEXT)],
        "",
    )


def markdown(found: Explanation) -> str:
    """Return an explanation as Markdown; it shows ``circuit.svg`` of the same folder."""
    blocks = [
        f"# {found.title}",
        f"Made by `{found.command} --out FOLDER`.\nThis run: {found.ending}.",
        "\n".join(f"{i}. {phase.sentence}" for i, phase in enumerate(found.findings.phases, 1)),
        "A pull is how far one synapse moves the potential that its neuron approaches, in mV, as a mean\n"
        "over the phase. Of a mixture of inputs or outputs the two largest parts are named.",
        "![circuit](circuit.svg)",
        "Each neuron is filled up to its mean potential, and each line is as thick as its mean current.\n"
        "Arrows excite, bars inhibit, dashed lines are gap junctions. Rings show ranges of time constants.",
    ]
    for title, before, header, rows, after in sections(found):
        lines = [f"| {' | '.join(row)} |" for row in (header, *rows)]
        lines.insert(1, "|---" * len(header) + "|")
        blocks += [f"## {title}", before, "\n".join(lines), after]
    return "\n\n".join(block for block in blocks if block) + "\n"


def write(found: Explanation, folder: Path) -> list[Path]:
    """Write page, text, tables and the circuit's picture; return the files. Raises FileError."""
    from deploy.view.page import circuit_svg  # the text needs no templates

    files = {
        "explanation.md": markdown(found),
        "explanation.html": page(found),
        "circuit.svg": circuit_svg(found.findings),
        **{f"{name}.csv": text for name, text in _tables(found).items()},
    }
    for name, content in files.items():
        write_atomic(folder / name, content)
    return [folder / name for name in sorted(files)]


def page(found: Explanation) -> str:
    """Return an explanation as a page."""
    from deploy.view.page import Table, run_page
    from deploy.view.recorded_drive import KINDS
    from deploy.view.shapes import OUTLINE, outline_of

    verdict = found.verdict
    if verdict is None:
        headline = (
            f"mean return {number(found.simulated.total)}",
            "",
            f"of {len(found.simulated.returns)} episodes",
        )
    else:
        headline = verdict.words.capitalize(), KINDS[verdict.words], verdict.reason
    drives = found.course is not None
    parts = sorted(found.knock_outs, key=lambda row: row.total)
    return run_page(
        found.findings,
        found.course,
        title=found.title,
        headline=headline,
        rows=[("Result", found.ending), ("Command", found.command)],
        outline=outline_of(found.robot) if found.robot else OUTLINE,
        tables=[
            Table(
                "Without a part",
                f"The simulation without each neuron and each synapse. The return of the whole circuit is "
                f"{number(found.simulated.total)}.",
                ["without", "return", *(["m from the goal", "parks"] if drives else [])],
                [(_part(row), -row.change) for row in parts],
            ),
            Table(
                SENSITIVITIES,
                f"The {ON_PAGE} parameters with the largest loss of return.",
                ["parameter", "value", "lower", "higher"],
                [(_sensitivity(row), -row.worst) for row in _deepest(found, ON_PAGE)],
            ),
        ],
    )


def _part(row: Knockout) -> list[str]:
    if row.error_m is None:
        return [row.title, number(row.total)]
    return [row.title, number(row.total, ".2f"), f"{row.error_m:.2f}", "yes" if row.parked else "no"]


def _deepest(found: Explanation, count: int) -> list[Sensitivity]:
    return sorted(found.sensitivities, key=lambda row: row.worst)[:count]


def _sensitivity(row: Sensitivity) -> list[str]:
    changes = [number(change, "+.3g") for change in (row.change_down, row.change_up)]
    return [row.title, f"{number(row.value)} {row.unit}".strip(), *changes]


def _without(found: Explanation) -> Section:
    parks = found.simulated.parked
    worse = [row for row in found.knock_outs if (not row.parked if parks else row.change <= -MIN_CHANGE)]
    needed = sorted(worse, key=lambda row: row.total)
    spared = [row.title for row in found.knock_outs if row not in needed and abs(row.change) < MIN_CHANGE]
    before = (
        f"Without any of these {len(needed)} it does not park:"
        if parks
        else "The whole circuit does not park in simulation; its return is "
        f"{number(found.simulated.total, '.2f')}. Without any of these {len(needed)} the return is lower:"
    )
    return Section(
        "Without a part",
        before,
        ["without", "return", "m from the goal"],
        [_part(row)[:3] for row in needed],
        _spared(spared),
    )


def _without_in_task(found: Explanation) -> Section:
    least = MIN_SHARE * abs(found.simulated.total)
    rows = sorted((row for row in found.knock_outs if abs(row.change) >= least), key=lambda row: row.total)
    total, count = number(found.simulated.total), len(found.simulated.returns)
    return Section(
        "Without a part",
        f"Mean return of {count} episodes; {total} with all parts.",
        ["without", "return"],
        [_part(row) for row in rows],
        _spared([row.title for row in found.knock_outs if abs(row.change) < least]),
    )


def _spared(titles: Sequence[str]) -> str:
    return f"Without any of these nothing changes: {', '.join(titles)}." if titles else ""


def _tables(found: Explanation) -> dict[str, str]:
    """Return the CSV files: the fields of the JSON, with all contributions, and the potentials."""
    trace, result = found.findings.trace, found.result().model_dump()
    result["contributions"] = [each.model_dump() for each in found.findings.contributions.values()]
    result["potentials"] = [
        {"t_s": t, **{f"{name}_mV": mV for name, mV in zip(trace.neurons, row, strict=True)}}
        for t, row in zip(trace.times.tolist(), trace.potentials.tolist(), strict=True)
    ]
    names = ("potentials", "contributions", "time_constants", "phases", "knock_outs", "sensitivities")
    return {name: _csv([dict(_flat(row)) for row in result[name]]) for name in names}


def _flat(fields: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield columns and cells; those of a field within a field or a list have both names."""
    for name, value in fields.items():
        if isinstance(value, dict | tuple):
            inside = value if isinstance(value, dict) else {str(i): each for i, each in enumerate(value)}
            yield from ((f"{name}_{inner}", cell) for inner, cell in _flat(inside))
        elif value is not None:
            yield name, value


def _csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a CSV file: numbers with all their digits, empty cells for what a row lacks."""
    buffer = io.StringIO()
    columns = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(buffer, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue()


def _signs(one: Contribution) -> str:
    return f"{SYMBOLS[one.sign]} {one.positive}/{one.negative}"
