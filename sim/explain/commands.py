"""Commands of this package; heavy libraries load only when one runs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rover_ncp.core.console import Json, Output

if TYPE_CHECKING:
    from rich.table import Table

    from deploy.report.analysis import Analysis
    from sim.explain.explained import Explained

SHOWN = 12
"""Rows of the longer tables; the files hold them all."""


def explain(
    source: Annotated[
        str, typer.Argument(help="A policy (name, YAML or .bnn), or a recording (.mcap) of a drive.")
    ],
    *,
    course: Annotated[
        str | None,
        typer.Option(
            help="Course to drive, by name or YAML file.", show_default="parking, or the recording's"
        ),
    ] = None,
    threshold: Annotated[
        float,
        typer.Option(
            min=1.0,
            help="Ratio by which one sign must outnumber the other, for a contribution to have a sign.",
        ),
    ] = 1.5,
    out: Annotated[
        Path | None, typer.Option(help="Folder for tables (CSV) and pictures (SVG and PNG).")
    ] = None,
    json: Json = False,
) -> None:
    """Explain how a circuit drives: the effect of each neuron, and the parts that the circuit needs.

    The output has a sentence for each phase of the manoeuvre, the contribution of each neuron to each motor
    neuron (Definition 1 of the paper, with its counts), and the range of each time constant. It also has the
    drive simulated again without each neuron and each synapse, and the sensitivity of the return to each
    parameter.
    """
    from rover_ncp.core.files import require_writable
    from sim.explain.explain import explain as explain_source
    from sim.explain.explain import write

    output = Output(json)
    if out is not None:
        require_writable(out / "explanation.md")
    found = explain_source(source, course, threshold=threshold, on_progress=output.say)
    for number, explanation in enumerate(found.analysis.explanations, 1):
        output.say(f"{number}. {explanation.text}")
    for table in _tables(found):
        output.console.print(table)
    written = write(found, out) if out is not None else []
    ending = f"{len(written)} files in {out}" if out is not None else "--out DIR writes tables and pictures"
    output.result({**found.fields(), "files": [str(path) for path in written]}, ending)


def report(
    source: Annotated[
        Path, typer.Argument(help="A recording (.mcap) of a drive, or the folder of a training run.")
    ],
    *,
    out: Annotated[
        Path | None,
        typer.Option(help="The page to write.", show_default="RUN.html, or report.html in the folder"),
    ] = None,
    json: Json = False,
) -> None:
    """Write a page about a drive, or a training: one HTML file, to be opened from disk.

    For a drive, the page shows the path, every neuron and synapse, the driver's commands and the gate's
    setpoints over one time slider, with a sentence for each phase of the manoeuvre. For a training, it shows
    the learning curves, the parameters against their bounds, and the drives of its policies. The page holds
    all its data and loads nothing from the network.
    """
    from sim.explain.pages import write_page

    output = Output(json)
    page = write_page(source, out)
    output.result({"page": str(page.path), "kind": page.kind, "bytes": page.size}, f"report: {page.path}")


def _tables(found: "Explained") -> "list[Table]":
    return [*_contributions(found.analysis), _time_constants(found), _without(found), _moved(found)]


def _table(title: str, first: str, *others: str) -> "Table":
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    table.add_column(first)
    for heading in others:
        table.add_column(heading, justify="right")
    return table


def _contributions(analysis: "Analysis") -> "list[Table]":
    from deploy.report.charts.neuron_pairs import SYMBOLS
    from deploy.report.published import CONTRIBUTIONS

    table = _table(
        "Contributions, P/Q: + positive, − antagonistic, ± phase-switching", "from", *analysis.motors
    )
    for name in analysis.sources:
        contributions = [analysis.contributions[name, motor] for motor in analysis.motors]
        table.add_row(name, *(f"{SYMBOLS[one.sign]} {one.positive}/{one.negative}" for one in contributions))
    tables = [table]
    for motor in analysis.motors:
        pairs = [(name, motor) for name in analysis.sources if (name, motor) in CONTRIBUTIONS]
        if pairs:
            beside = _table(f"To {motor}, beside the paper", "from", "whole run", "while driving", "paper")
            for pair in pairs:
                one, driving = analysis.contributions[pair], analysis.driving[pair]
                beside.add_row(pair[0], str(one.sign), str(driving.sign), str(CONTRIBUTIONS[pair]))
            tables.append(beside)
    return tables


def _time_constants(found: "Explained") -> "Table":
    table = _table("Time constants (s)", "neuron", "lowest", "highest")
    for constant in found.analysis.time_constants:
        table.add_row(constant.neuron, f"{constant.lowest_s:.3g}", f"{constant.highest_s:.3g}")
    return table


def _without(found: "Explained") -> "Table":
    table = _table("Driving without a part, the worst first", "without", "return", "m from the goal", "parks")
    needed = [row for row in found.knock_outs if not row.parked]
    for row in sorted(needed, key=lambda row: row.total)[:SHOWN]:
        name = f"neuron {row.name}" if row.kind == "neuron" else row.name
        table.add_row(name, f"{row.total:.3f}", f"{row.error_m:.3f}", "no")
    spared = [row.name for row in found.knock_outs if row.parked]
    if len(needed) > SHOWN:
        table.add_row(f"and {len(needed) - SHOWN} more", "", "", "no")
    if spared:
        table.add_row(f"any of {len(spared)} others", "", "", "yes")
    return table


def _moved(found: "Explained") -> "Table":
    table = _table(
        "Change of the return when a parameter moves by 1 % of its range", "parameter", "lower", "higher"
    )
    for row in sorted(found.sensitivities, key=lambda row: row.worst)[:SHOWN]:
        name = f"{row.kind.replace('_', ' ')}, {row.name}"
        table.add_row(name, f"{row.change_down:+.3f}", f"{row.change_up:+.3f}")
    return table
